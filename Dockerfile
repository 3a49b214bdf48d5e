# Simulation and planning in a container: docker build -t tenscasadi . && docker run --rm tenscasadi plan prism
# The viewer: docker run --rm -p 8080:8080 tenscasadi view prism --host 0.0.0.0 --port 8080
FROM python:3.12-slim
RUN apt-get update && apt-get install --yes --no-install-recommends g++ && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY . .
RUN pip install --no-cache-dir ".[all]"
WORKDIR /work
ENTRYPOINT ["tenscasadi"]
