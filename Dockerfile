# CodeMirror's modules for the editor of protocols, as published; nothing else of Node is in the image.
FROM node:22.12.0-bookworm-slim AS browser
WORKDIR /desirepath
COPY package.json ./
COPY scripts scripts
RUN scripts/setup_node.sh

# Desire Path: pages, stage and worker share one image.
FROM python:3.11.13-slim-bookworm
ENV PYTHONUNBUFFERED=1
WORKDIR /desirepath
COPY requirements.lock pyproject.toml mkdocs.yml Makefile README.md LICENSE ./
COPY scripts scripts
COPY app app
COPY backend backend
COPY experiments experiments
# PyBullet has wheels for amd64 only; elsewhere it is compiled.
ARG DESIREPATH_TORCH_INDEX
# Backups need pg_dump of the database's own version; Debian's is older, so PostgreSQL's own packages (as its site says).
RUN apt-get update && apt-get install -y --no-install-recommends postgresql-common ca-certificates \
 && /usr/share/postgresql-common/pgdg/apt.postgresql.org.sh -y \
 && apt-get install -y --no-install-recommends postgresql-client-17 && rm -rf /var/lib/apt/lists/*
# The package names the folders that come below; they come late, so that a new text builds no environment anew.
RUN apt-get update && apt-get install -y --no-install-recommends make g++ \
 && mkdir frontend docs study_protocols datasets && scripts/setup.sh \
 && .venv/bin/python -m compileall -q app backend experiments \
 && apt-get purge -y g++ && apt-get autoremove -y && rm -rf /var/lib/apt/lists/* /root/.cache
COPY frontend frontend
COPY --from=browser /desirepath/frontend/static/npm frontend/static/npm
COPY docs docs
COPY study_protocols study_protocols
COPY datasets datasets
RUN useradd --create-home desirepath && mkdir -m 700 data && chown desirepath data
USER desirepath
ENV PATH=/desirepath/.venv/bin:$PATH DESIREPATH_DATA=/desirepath/data DESIREPATH_HOST=0.0.0.0
VOLUME /desirepath/data
EXPOSE 8000 8001
CMD ["desirepath", "serve"]
