# A build, then a slim image that holds four binaries and libtorch's CPU part.
# Every step is the one CI runs: scripts/libtorch.sh, then cargo with the committed lock file.

FROM rust:1.95-slim-bookworm AS build
RUN apt-get update \
 && apt-get install -y --no-install-recommends g++ make python3 python3-pip \
 && rm -rf /var/lib/apt/lists/*
WORKDIR /src
ENV XDG_CACHE_HOME=/cache
# libtorch changes least, so it is its own layer.
COPY scripts/libtorch.sh scripts/
RUN scripts/libtorch.sh
COPY . .
RUN make build \
 && mkdir -p /out/bin /out/lib \
 && cp target/release/gleaner-server target/release/gleaner-inspector target/release/gleaner-worker target/release/gleaner /out/bin/ \
 && cp -L .libtorch/lib/* /out/lib/

FROM debian:bookworm-slim
RUN apt-get update \
 && apt-get install -y --no-install-recommends ca-certificates libstdc++6 \
 && rm -rf /var/lib/apt/lists/* \
 && useradd --system --create-home --home-dir /var/lib/gleaner gleaner \
 && install -d -o gleaner -g gleaner /var/lib/gleaner/data
COPY --from=build /out/bin/ /usr/local/bin/
COPY --from=build /out/lib/ /usr/local/lib/gleaner/
ENV LD_LIBRARY_PATH=/usr/local/lib/gleaner \
    GLEANER_DATA_DIR=/var/lib/gleaner/data \
    GLEANER_LISTEN=127.0.0.1:7400
USER gleaner
VOLUME /var/lib/gleaner/data
ENTRYPOINT ["gleaner-server"]
CMD ["serve"]
