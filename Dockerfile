# The web page and the service in a container:
#   docker build -t angie .
#   docker run --rm -p 7860:7860 -e ANGIE_TOKEN=a-long-random-word angie
# then open http://localhost:7860/?token=a-long-random-word
FROM python:3.12-slim
RUN useradd --create-home angie
WORKDIR /home/angie/source
COPY pyproject.toml README.md LICENSE ./
COPY angie angie
COPY mraa mraa
COPY data_prep data_prep
RUN pip install --no-cache-dir ".[app]" && rm -rf build
USER angie
WORKDIR /home/angie
EXPOSE 7860
HEALTHCHECK --start-period=120s CMD ["python", "-c", "import urllib.request as r; r.urlopen('http://127.0.0.1:7860/health')"]
CMD ["angie", "app", "--host", "0.0.0.0", "--port", "7860"]
