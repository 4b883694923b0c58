# The command line in a slim image: docker build -t interloc . && docker run -v "$PWD:/data" interloc info DRIVE
FROM python:3.11-slim AS build
WORKDIR /src
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY interloc interloc
COPY app app
RUN python -m venv /opt/interloc \
 && /opt/interloc/bin/pip install --no-cache-dir -c constraints.txt .

FROM python:3.11-slim
# The bindings of libosmium read XML through expat.
RUN apt-get update \
 && apt-get install -y --no-install-recommends libexpat1 \
 && rm -rf /var/lib/apt/lists/* \
 && useradd --create-home interloc \
 && mkdir -p /var/cache/interloc /data \
 && chown interloc /var/cache/interloc /data
COPY --from=build /opt/interloc /opt/interloc
# The compiled kernels are kept here between runs.
ENV PATH=/opt/interloc/bin:$PATH NUMBA_CACHE_DIR=/var/cache/interloc MPLCONFIGDIR=/var/cache/interloc
USER interloc
WORKDIR /data
ENTRYPOINT ["interloc"]
CMD ["--help"]
