# docker build -t sat-recon . && docker run --rm -v "$PWD:/work" sat-recon video.mp4
FROM rust:1-bookworm AS build
WORKDIR /src
RUN apt-get update && apt-get install -y --no-install-recommends \
    pkg-config g++ libceres-dev libsqlite3-dev nodejs npm && rm -rf /var/lib/apt/lists/*
COPY . .
RUN tools/viewer.sh && cargo build --release --locked

FROM debian:12-slim
RUN apt-get update && apt-get install -y --no-install-recommends \
    libceres3 libsqlite3-0 ffmpeg mesa-vulkan-drivers && rm -rf /var/lib/apt/lists/*
COPY --from=build /src/target/release/sat-recon /usr/local/bin/sat-recon
WORKDIR /work
ENTRYPOINT ["sat-recon"]
