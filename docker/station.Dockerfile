# The station: link, SLAM, places, API and page.
FROM python:3.12-slim
WORKDIR /app
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY shared shared
COPY robot robot
COPY station station
RUN pip install --no-cache-dir -c constraints.txt ".[station]" && useradd --create-home sentinel
USER sentinel
VOLUME /home/sentinel/data
EXPOSE 8080
ENTRYPOINT ["station"]
CMD ["serve", "--host", "0.0.0.0", "--data", "/home/sentinel/data"]
