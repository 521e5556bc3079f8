# docker build -t plp .                                      # CPU
# docker build -t plp-gpu --build-arg TORCH=gpu .            # NVIDIA GPU: docker run --gpus all plp-gpu …
# docker run --rm -v "$PWD/runs:/plp/runs" -v "$PWD/data:/plp/data" plp fit --config configs/r2r.yaml
FROM python:3.11-slim-bookworm

RUN apt-get update \
    && apt-get install -y --no-install-recommends libegl1 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --create-home --uid 1000 plp \
    && install -d -o plp -g plp /plp

USER plp
WORKDIR /plp
COPY --chown=plp:plp . .

ARG TORCH=cpu
# The second step makes the folders that a volume may cover, so that they belong to plp.
RUN PIP_NO_CACHE_DIR=1 PLP_TORCH=$TORCH script/setup && mkdir -p data runs

# EGL renders without a display, on the GPU if the driver brings its part (capability "graphics").
ENV PATH=/plp/.venv/bin:$PATH \
    MUJOCO_GL=egl \
    NVIDIA_DRIVER_CAPABILITIES=compute,utility,graphics
ENTRYPOINT ["plp"]
CMD ["--help"]
