"""Time loop in machine code, CasADi's virtual machine, or SUNDIALS."""
