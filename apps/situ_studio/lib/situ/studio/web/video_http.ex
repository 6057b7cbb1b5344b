defmodule Situ.Studio.Web.VideoHttp do
  @moduledoc false
  # Serves compressed images to pages that decode them: the index of a stream, and the bytes of its packets, one after
  # the other. If only the server can decode a stream, the reply says why.
  alias Situ.Live.{Request, Response}
  alias Situ.Studio.{CodedStreams, Comparison, Int64}

  @spec call(Request.t(), {String.t(), :index | :packets}) :: Response.t()
  def call(%Request{query: query}, {studio, what}) do
    with stream when is_binary(stream) <- query["stream"],
         {:ok, _item, source, _} <- Comparison.open_item(studio, query["source"], query) do
      build_response(what, source, stream, query)
    else
      {:error, error} -> Response.error(404, error.what)
      _ -> bad_request()
    end
  end

  defp build_response(:index, source, stream, query) do
    found =
      if query["small"],
        do: CodedStreams.fetch_small(source, stream),
        else: CodedStreams.fetch(source, stream)

    case found do
      {:ok, video} -> Response.json(CodedStreams.to_map(video))
      :none -> Response.json(%{"codec" => nil})
      :pending -> Response.json(%{"codec" => nil, "pending" => true})
      {:error, error} -> Response.json(%{"codec" => nil, "problem" => describe_error(error)})
    end
  end

  defp build_response(:packets, source, stream, query) do
    with {:ok, first} when first >= 0 <- Int64.parse(query["first"]),
         {:ok, count} when count in 1..100_000 <- Int64.parse(query["count"]) do
      read =
        if query["small"],
          do: &CodedStreams.read_small_packets/4,
          else: &CodedStreams.read_packets/4

      case read.(source, stream, first, count) do
        {:ok, packets} -> Response.binary(packets, [{"cache-control", "no-store"}])
        none when none in [:none, :pending] -> bad_request()
        {:error, error} -> Response.error(422, describe_error(error))
      end
    else
      _ -> bad_request()
    end
  end

  defp describe_error(%{what: what, why: why}) when is_binary(why), do: "#{what}: #{why}"
  defp describe_error(%{what: what}), do: what

  defp bad_request, do: Response.error(400, "invalid request for video")
end
