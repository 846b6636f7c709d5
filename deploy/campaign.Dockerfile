# The laboratory with a cluster: scheduler, workers and the commands that use them.
# From the root of the checkout:  docker build -f deploy/campaign.Dockerfile -t armadico-campaign .

FROM python:3.11-slim-bookworm AS build
WORKDIR /src
COPY requirements/cluster.txt requirements/
RUN python -m venv --without-pip /opt/armadico \
 && pip --python /opt/armadico/bin/python install --no-cache-dir --require-hashes -r requirements/cluster.txt
COPY pyproject.toml README.md LICENSE ./
COPY armadico armadico
COPY agents agents
COPY bridge bridge
COPY configs configs
COPY deploy/bin deploy/bin
COPY tools tools
RUN pip --python /opt/armadico/bin/python install --no-cache-dir --no-deps --no-build-isolation . ./tools \
 && pip --python /opt/armadico/bin/python uninstall --yes setuptools wheel

FROM python:3.11-slim-bookworm
RUN useradd --uid 10001 --no-create-home --home-dir /tmp --shell /usr/sbin/nologin armadico
COPY --from=build /opt/armadico /opt/armadico
ENV PATH=/opt/armadico/bin:$PATH \
    HOME=/tmp \
    PYTHONUNBUFFERED=1
USER 10001:10001
WORKDIR /results
ENTRYPOINT ["armadico"]
CMD ["--help"]
