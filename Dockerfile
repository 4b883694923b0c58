# The web service with its page, and the command line, in a slim image:
#   docker build -t interloc .
#   docker run --rm -v interloc:/data interloc admin token add me       # prints the token to log in with, once
#   docker run -p 8000:8000 -v interloc:/data interloc
#   docker run -v "$PWD:/work" -w /work interloc info DRIVE
FROM node:22-slim AS page
WORKDIR /static
COPY static/package.json static/package-lock.json static/.npmrc ./
RUN npm ci --omit=dev
COPY static ./
RUN npm run build

# What InterLoc needs, without what nobody runs: tests, headers, debug symbols, pip, and bytecode of modules that are never
# imported. GeoParquet needs 170 MB more: --build-arg EXTRAS=service,dask,label,ros,las,odometry,storage,parquet
FROM python:3.11-slim AS packages
ARG EXTRAS=service,dask,label,ros,las,odometry,storage
WORKDIR /src
RUN apt-get update && apt-get install -y --no-install-recommends binutils
COPY pyproject.toml constraints.txt ./
RUN python -m venv /opt/interloc \
 && python -c 'import sys, tomllib; project = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
extras = project["optional-dependencies"]; \
print(*project["dependencies"], *(need for extra in sys.argv[1].split(",") for need in extras[extra]), sep="\n")' "$EXTRAS" > needs.txt \
 && /opt/interloc/bin/pip install --no-cache-dir --no-compile -c constraints.txt -r needs.txt \
 && /opt/interloc/bin/pip uninstall --yes --quiet pip setuptools \
 && cd /opt/interloc/lib/python3.11/site-packages \
 && find . -type d \( -name tests -o -name include -o -name __pycache__ \) -prune -exec rm -r {} + \
 && find . -name '*.so' -not -path '*.libs/*' -exec strip --strip-debug {} +

FROM python:3.11-slim AS build
WORKDIR /src
COPY pyproject.toml hatch_build.py constraints.txt README.md LICENSE ./
COPY interloc interloc
COPY app app
COPY --from=page /static static
RUN python -m venv /builder \
 && /builder/bin/pip install --no-cache-dir --no-compile --no-deps --prefix /project . \
 && sed -i '1s,.*,#!/opt/interloc/bin/python,' /project/bin/interloc

FROM python:3.11-slim
LABEL org.opencontainers.image.title=InterLoc \
      org.opencontainers.image.description="Road intersections from LiDAR drives, scored against OpenStreetMap" \
      org.opencontainers.image.licenses=MIT
# The bindings of libosmium read XML through expat.
RUN apt-get update \
 && apt-get install -y --no-install-recommends libexpat1 \
 && rm -rf /var/lib/apt/lists/* \
 && useradd --create-home --uid 1000 interloc \
 && mkdir -p /var/cache/interloc /data \
 && chown interloc /var/cache/interloc /data
# What changes rarely first: a new version of InterLoc is the last two layers.
COPY --from=packages /opt/interloc /opt/interloc
COPY --from=build /project /opt/interloc
# The kernels are compiled for processors of 2013 and later, whichever builds the image; elsewhere: --build-arg CPU=generic
ARG CPU=x86-64-v3
ENV PATH=/opt/interloc/bin:$PATH NUMBA_CACHE_DIR=/var/cache/interloc MPLCONFIGDIR=/var/cache/interloc \
    NUMBA_CPU_NAME=$CPU NUMBA_CPU_FEATURES= \
    INTERLOC_DATA_DIR=/data INTERLOC_HOST=0.0.0.0
# Compiled once, here, kernels and bytecode: neither the start of a container nor its first job waits for it.
RUN python -c "import app.main; from app.work.kinds import compile_kernels; compile_kernels()" \
 && chown -R interloc /var/cache/interloc
USER interloc
WORKDIR /data
VOLUME /data
EXPOSE 8000
HEALTHCHECK --interval=30s --timeout=5s --start-period=60s \
    CMD ["python", "-c", "import os, urllib.request as r; r.urlopen(f'http://127.0.0.1:{os.environ.get(\"INTERLOC_PORT\", 8000)}/healthz', timeout=4)"]
ENTRYPOINT ["interloc"]
# Other machines can connect: without a token on the volume it says how to make one, and ends.
CMD ["serve"]
