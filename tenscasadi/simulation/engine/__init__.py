"""One engine for runs: machine code, CasADi's virtual machine, or SUNDIALS."""
