defmodule Situ.Studio.Web.Routes do
  @moduledoc false
  # Lists the addresses of a studio.
  alias Situ.Studio.{Headset, PipelineView, Sensor}

  alias Situ.Studio.Web.{
    ClusterView,
    DataHandler,
    DataHttp,
    DatasetView,
    ExperimentReport,
    ExperimentView,
    HeadsetPage,
    HomeView,
    MainView,
    MetricsHttp,
    SensorHandler,
    SensorPage,
    SettingsView,
    UploadHandler,
    VideoHttp
  }

  @spec build_routes(String.t(), String.t()) :: [tuple()]
  def build_routes(studio, base \\ "/") do
    # The role is signed into each page, so that a viewer's page keeps its view-only role over its socket.
    session = &%{"studio" => studio, "viewer" => &1.role == :viewer}

    [
      {:live, "/", HomeView, session: session},
      {:live, "/settings", SettingsView, session: session},
      {:live, "/cluster", ClusterView, session: session},
      {:live, "/s/*id", MainView, session: session},
      {:live, "/d/*id", DatasetView, session: session},
      {:live, "/x/*id", ExperimentView, session: session},
      {:live, "/p/*id", PipelineView, session: session},
      {:static, "/assets", {:situ_studio, "priv/static"}},
      {:socket, "/data/socket", DataHandler, studio, max_frame: 262_144},
      {:socket, "/upload/socket", UploadHandler, studio, max_frame: 262_144},
      {:get, "/sensor", {SensorPage, {studio, base}}},
      {:socket, "/sensor/socket", SensorHandler, Sensor, max_frame: 2_097_152},
      {:get, "/headset", {HeadsetPage, {studio, base}}},
      {:socket, "/headset/socket", SensorHandler, Headset, max_frame: 262_144},
      {:get, "/experiments/report", {ExperimentReport, studio}},
      {:get, "/metrics", {MetricsHttp, :metrics}},
      {:get, "/health", {MetricsHttp, :health}},
      {:get, "/data/window", {DataHttp, {studio, :window}}},
      {:get, "/data/at", {DataHttp, {studio, :at}}},
      {:get, "/data/pcm", {DataHttp, {studio, :pcm}}},
      {:get, "/data/video", {VideoHttp, {studio, :index}}},
      {:get, "/data/packets", {VideoHttp, {studio, :packets}}},
      {:get, "/data/step", {DataHttp, {studio, :step}}},
      {:get, "/data/csv", {DataHttp, {studio, :csv}}},
      {:get, "/data/parquet", {DataHttp, {studio, :parquet}}},
      {:get, "/data/wav", {DataHttp, {studio, :wav}}},
      {:get, "/data/film", {DataHttp, {studio, :film}}},
      {:get, "/data/thumbnail", {DataHttp, {studio, :thumbnail}}}
    ]
  end
end
