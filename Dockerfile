# The web service with its page, and the command line, in a slim image:
#   docker build -t interloc .
#   docker run --rm -v interloc:/data interloc token add me       # prints the token to log in with, once
#   docker run -p 8000:8000 -v interloc:/data interloc
#   docker run -v "$PWD:/work" -w /work interloc info DRIVE
FROM node:22-slim AS page
WORKDIR /static
COPY static/package.json static/package-lock.json static/.npmrc ./
RUN npm ci --omit=dev
COPY static ./

FROM python:3.11-slim AS build
WORKDIR /src
COPY pyproject.toml hatch_build.py constraints.txt README.md LICENSE ./
COPY interloc interloc
COPY app app
COPY --from=page /static static
RUN python -m venv /opt/interloc \
 && /opt/interloc/bin/pip install --no-cache-dir -c constraints.txt ".[service,dask,label,ros,las,odometry,parquet,storage]"

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
COPY --from=build /opt/interloc /opt/interloc
# The compiled kernels are kept here between runs.
ENV PATH=/opt/interloc/bin:$PATH NUMBA_CACHE_DIR=/var/cache/interloc MPLCONFIGDIR=/var/cache/interloc \
    INTERLOC_DATA_DIR=/data INTERLOC_HOST=0.0.0.0
USER interloc
# Compiled once, here: the first job of a container does not wait for it.
RUN python -c "from app.work.kinds import compile_kernels; compile_kernels()"
WORKDIR /data
VOLUME /data
EXPOSE 8000
HEALTHCHECK --interval=30s --timeout=5s --start-period=60s \
    CMD ["python", "-c", "import os, urllib.request as r; r.urlopen(f'http://127.0.0.1:{os.environ.get(\"INTERLOC_PORT\", 8000)}/healthz', timeout=4)"]
ENTRYPOINT ["interloc"]
# Other machines can connect: without a token on the volume it says how to make one, and ends.
CMD ["serve"]
