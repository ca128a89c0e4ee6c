# Saltus for an ordinary user, without a GPU and without what training needs: docker build -t saltus .
FROM debian:bookworm-slim

RUN apt-get update && apt-get install -y --no-install-recommends ca-certificates python3 python3-venv
COPY tools/libraries.sh /tmp/libraries.sh
RUN /tmp/libraries.sh && rm -rf /tmp/libraries.sh /var/lib/apt/lists/*

RUN useradd --create-home --shell /bin/bash saltus
USER saltus
WORKDIR /home/saltus
COPY --chown=saltus . source
RUN python3 -m venv venv && venv/bin/pip install --no-cache-dir ./source && rm -rf source && mkdir runs

ENV PATH="/home/saltus/venv/bin:$PATH"
ENTRYPOINT ["saltus"]
CMD ["--help"]
