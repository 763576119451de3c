# sat-recon in a container: docker build -t sat-recon . && docker run --rm -v "$PWD:/work" sat-recon video.mp4
# tools/container.sh builds and runs it, where no engine runs as a root file system in a chroot.
FROM rust:1-bookworm AS build
RUN apt-get update && apt-get install -y --no-install-recommends make git nodejs npm ca-certificates
COPY . /source
WORKDIR /source
RUN make build

FROM debian:bookworm-slim
RUN apt-get update && apt-get install -y --no-install-recommends ffmpeg libceres3 libsqlite3-0 mesa-vulkan-drivers && rm -rf /var/lib/apt/lists/*
COPY --from=build /source/target/release/sat-recon /usr/local/bin/sat-recon
WORKDIR /work
ENTRYPOINT ["sat-recon"]
