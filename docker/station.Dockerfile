# The station: link, SLAM, places, API and page.
#   docker build -f docker/station.Dockerfile -t sentinel-station . && docker run --rm --network host sentinel-station
# It serves on loopback and looks for a robot there: with the host's network that is this machine. To let others in, set up
# who may (docs/access.md) and give --host 0.0.0.0; compose.yaml connects it with a simulated robot.
FROM python:3.12-slim
WORKDIR /app
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY shared shared
COPY robot robot
COPY station station
RUN pip install --no-cache-dir -c constraints.txt ".[station]" && useradd --create-home sentinel
# A volume takes its owner from the folder in the image: without one it would be root's, and nothing could be recorded.
RUN mkdir /home/sentinel/data && chown sentinel:sentinel /home/sentinel/data
USER sentinel
WORKDIR /home/sentinel
VOLUME /home/sentinel/data
EXPOSE 8080
ENTRYPOINT ["station"]
CMD ["serve", "--data", "data"]
