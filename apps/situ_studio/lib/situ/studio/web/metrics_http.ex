defmodule Situ.Studio.Web.MetricsHttp do
  @moduledoc false
  # Serves the metrics and the health of the studio's node (`Situ.Metrics`), with the studio's access rules.
  alias Situ.Live.{Request, Response}
  alias Situ.Metrics

  @spec call(Request.t(), :metrics | :health) :: Response.t()
  def call(%Request{}, :metrics) do
    headers = [{"content-type", Metrics.content_type()}, {"cache-control", "no-store"}]
    %Response{headers: headers, body: Metrics.to_text(Metrics.collect())}
  end

  def call(%Request{query: query}, :health) do
    expected = for name <- List.wrap(query["pipeline"]), is_binary(name), do: name
    unhealthy = Metrics.unhealthy_pipelines(expected)
    Response.json(Metrics.health_report(unhealthy), if(unhealthy == [], do: 200, else: 503))
  end
end
