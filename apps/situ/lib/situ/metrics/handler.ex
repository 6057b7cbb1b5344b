defmodule Situ.Metrics.Handler do
  @moduledoc false
  # Responds to the requests of `Situ.Metrics.Server`, as a module of Erlang's web server.
  require Record
  alias Situ.Metrics

  Record.defrecordp(:mod, Record.extract(:mod, from_lib: "inets/include/httpd.hrl"))

  @doc "Handles one request. Called by `:httpd`."
  @spec unquote(:do)(tuple()) :: {:proceed, [term()]}
  def unquote(:do)(request) do
    {status, type, body} = respond(mod(request, :method), mod(request, :request_uri))
    text = IO.iodata_to_binary(body)

    head = [
      code: status,
      content_type: String.to_charlist(type),
      content_length: text |> byte_size() |> Integer.to_charlist(),
      cache_control: 'no-store'
    ]

    {:proceed, [response: {:response, head, [text]}]}
  end

  @doc "Returns the status, the content type and the body of a response."
  @spec respond(charlist(), charlist()) :: {100..599, String.t(), iodata()}
  def respond(method, _uri) when method not in ['GET', 'HEAD'],
    do: {405, "text/plain", "only GET\n"}

  def respond(_method, uri) do
    %URI{path: path, query: query} = uri |> to_string() |> URI.parse()

    case path do
      "/metrics" -> {200, Metrics.content_type(), Metrics.to_text(Metrics.collect())}
      "/health" -> health_response(query)
      _ -> {404, "text/plain", "not found: see /metrics and /health\n"}
    end
  end

  # The query may name pipelines: `pipeline=A&pipeline=B`.
  defp health_response(query) do
    expected = for {"pipeline", name} <- URI.query_decoder(query || ""), do: name
    unhealthy = Metrics.unhealthy_pipelines(expected)
    status = if unhealthy == [], do: 200, else: 503
    {status, "application/json", Situ.JSON.encode(Metrics.health_report(unhealthy))}
  end
end
