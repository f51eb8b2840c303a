# A simulated robot: robot-server with devices that need no hardware.
FROM python:3.12-slim
WORKDIR /app
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY shared shared
COPY robot robot
COPY station station
RUN pip install --no-cache-dir -c constraints.txt ".[robot,simulation]" && useradd --create-home sentinel
USER sentinel
EXPOSE 7400
ENTRYPOINT ["robot-server"]
CMD ["--devices", "simulated", "--world", "home", "--seed", "1", "--host", "0.0.0.0"]
