# syntax=docker/dockerfile:1
# Two stages: the first builds and installs, the second carries only the result.

FROM python:3.11-slim AS build
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1
WORKDIR /src
RUN python -m venv /opt/pharos
COPY constraints.txt ./
RUN python -m pip install -c constraints.txt uv
COPY pyproject.toml README.md LICENSE ./
COPY migrations ./migrations
COPY app ./app
RUN uv pip install --python /opt/pharos/bin/python -c constraints.txt -b constraints.txt '.[postgres]'

FROM python:3.11-slim
RUN useradd --system --uid 10001 --home-dir /var/lib/pharos --create-home pharos
COPY --from=build /opt/pharos /opt/pharos
# Compiled kernels are cached in the home folder: the installed package is not writable.
ENV PATH=/opt/pharos/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    NUMBA_CACHE_DIR=/var/lib/pharos/numba \
    PHAROS_HOST=0.0.0.0 \
    PHAROS_PORT=8000 \
    PHAROS_DATABASE_URL=sqlite:////var/lib/pharos/pharos.db \
    PHAROS_SPOOL_DIR=/var/lib/pharos/uploads
USER 10001
WORKDIR /var/lib/pharos
VOLUME /var/lib/pharos
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=3s --start-period=60s --retries=3 \
    CMD ["python", "-c", "import os, urllib.request as r; r.urlopen('http://127.0.0.1:' + os.environ['PHAROS_PORT'] + '/healthz', timeout=2)"]
CMD ["pharos", "serve"]
