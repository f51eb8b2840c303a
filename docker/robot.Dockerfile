# A simulated robot: robot-server with devices that need no hardware.
#   docker build -f docker/robot.Dockerfile -t sentinel-robot . && docker run --rm --network host sentinel-robot
# It listens on loopback, so only with the host's network can a station outside reach it; compose.yaml connects the two.
FROM python:3.12-slim
WORKDIR /app
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY shared shared
COPY robot robot
COPY station station
RUN SENTINEL_NO_PAGE=1 pip install --no-cache-dir -c constraints.txt ".[robot,simulation]" && useradd --create-home sentinel
USER sentinel
EXPOSE 7400 7400/udp
ENTRYPOINT ["robot-server"]
CMD ["--devices", "simulated", "--world", "home", "--seed", "1"]
