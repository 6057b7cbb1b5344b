defmodule Situ.Link.Server.Requests do
  @moduledoc false
  # Handles the requests of clients to a recording (`{:request, id, map}`) and builds the bodies
  # of the replies. The client side is the reader `Situ.Link.Recording`.
  #
  # | `op` | further keys | reply |
  # |---|---|---|
  # | `open` | | info, with `version` |
  # | `streams`; `stream` | `stream` | list of maps; one |
  # | `seek`, `count` | `stream`, `time` | ordinal, number |
  # | `read` | `stream`, `ordinal`, `to`, `limit`, `exact`, `envelopes`, `skip_damage` | 64 bits of ordinal, batches |
  # | `summary`, `tracks` | `stream`, `from`, `to`, `pixels` or `level` and `most` | as in `Situ.Recording` |
  # | `gaps`; `missing_files` | `stream`, `least` | lists |
  # | `await` | `known` | `{:published \| :ended, n}`, once there is more than `known` |
  #
  # Every request except `open` contains the `version` returned by `open`. All replies except
  # those to `read` are external terms, which the client reads with the checked decoder of stores.
  # A body is sent in segments: each begins with the byte 0, the last one with 1. The byte 2
  # precedes an error as JSON.
  # See docs/adr/0115-remote-recordings-answer-requests.md.
  alias Situ.{Error, JSON}
  alias Situ.Link.Wire.{Batch, Handshake}
  alias Situ.Recording
  alias Situ.Store.{Query, StreamInfo}

  # Limits for the messages in one reply. The second one applies if the client wants exactly as many as it asked for.
  @max_messages 4_096
  @max_exact 16
  @max_pixels 100_000
  @part_bytes 1024 * 1024

  @doc """
  Handles a request. Returns the segments of the reply or, for `await`, the number above which the client wants to be
  notified.
  """
  @spec handle_request(Recording.t(), map()) :: {:ok, [iodata()]} | {:await, non_neg_integer()}
  def handle_request(%Recording{} = store, %{"op" => "await"} = request) do
    with {:ok, known} <- parse_number(request["known"], 0, 0xFFFFFFFFFFFF),
         true <- Recording.implements?(store, :notify, 4) do
      {:await, known}
    else
      _ -> {:ok, term_reply({:ended, 0})}
    end
  end

  def handle_request(%Recording{} = store, request) do
    case run_operation(request["op"], store, request) do
      {:ok, body} -> {:ok, body}
      {:error, %Error{} = error} -> {:ok, error |> hide_path(store) |> error_reply()}
      {:error, why} -> {:ok, error_reply(bad_request_error(why))}
    end
  rescue
    error in Error -> {:ok, error |> hide_path(store) |> error_reply()}
  end

  # Clients must not see paths of this machine.
  defp hide_path(error, store) do
    redact = &(&1 && String.replace(&1, store.path, Path.basename(store.path)))
    %{error | what: redact.(error.what), why: redact.(error.why), fix: redact.(error.fix)}
  end

  @doc "Builds the reply for an error."
  @spec error_reply(Error.t()) :: [iodata()]
  def error_reply(%Error{} = error), do: [[2, JSON.encode(Handshake.error_to_map(error))]]

  @doc "Builds the reply for a term."
  @spec term_reply(term()) :: [iodata()]
  def term_reply(term), do: term |> :erlang.term_to_binary() |> split_body()

  defp run_operation("open", store, _request) do
    info = Query.info(store)
    fields = [:name, :version, :created, :closed?, :live?, :volatile?, :entries, :damage, :id]
    {:ok, info |> Map.take(fields) |> term_reply()}
  end

  defp run_operation("streams", store, _request),
    do: {:ok, store |> Query.streams() |> streams_to_maps() |> term_reply()}

  defp run_operation("missing_files", store, _request),
    do: {:ok, store |> Query.missing_files() |> term_reply()}

  defp run_operation(op, store, %{"stream" => name} = request) when is_binary(name) do
    with {:ok, info} <- Query.stream_info(store, name),
         do: run_stream_operation(op, store, info, request)
  end

  defp run_operation(op, _store, _request),
    do: {:error, "the operation #{inspect(op)} needs a stream"}

  defp run_stream_operation("stream", _store, info, _request),
    do: {:ok, [info] |> streams_to_maps() |> term_reply()}

  defp run_stream_operation("count", store, info, _request),
    do: {:ok, store |> Query.count(info) |> term_reply()}

  defp run_stream_operation("seek", store, info, request) do
    with {:ok, time} <- parse_time(request["time"]),
         {:ok, ordinal} <- Query.seek_ordinal(store, info, time),
         do: {:ok, term_reply(ordinal)}
  end

  defp run_stream_operation("gaps", store, info, request) do
    with {:ok, least} <- parse_time(request["least"]),
         do: {:ok, store |> Query.gaps(info, least) |> term_reply()}
  end

  defp run_stream_operation("read", store, info, request) do
    exact? = request["exact"] == true
    flags = [exact: exact?, envelopes: request["envelopes"] == true]
    opts = [skip_damage: request["skip_damage"] == true] ++ flags

    with {:ok, ordinal} <- parse_number(request["ordinal"], 0, 0xFFFFFFFFFFFFFF),
         {:ok, to} <-
           if(request["to"] == nil, do: {:ok, :unbounded}, else: parse_time(request["to"])),
         {:ok, limit} <- parse_number(request["limit"], 1, 0xFFFFFFFF),
         limit = min(limit, if(exact?, do: @max_exact, else: @max_messages)),
         {:ok, messages, next} <- Query.read_batch(store, info, ordinal, to, limit, opts) do
      batches =
        for {_, _, _, payload} <- Batch.encode(messages),
            do: [<<IO.iodata_length(payload)::32>>, payload]

      {:ok, split_body(IO.iodata_to_binary([<<next::64>> | batches]))}
    end
  end

  defp run_stream_operation("summary", store, info, request) do
    with {:ok, from} <- parse_time(request["from"]),
         {:ok, to} <- parse_time(request["to"]),
         {:ok, pixels} <- parse_number(request["pixels"], 1, @max_pixels),
         :ok <- check_supported(store, :summary, 5),
         {:ok, width, bins} <- store.module.summary(store.state, info, from, to, pixels),
         do: {:ok, term_reply({width, bins})}
  end

  defp run_stream_operation("tracks", store, info, request) do
    with {:ok, from} <- parse_time(request["from"]),
         {:ok, to} <- parse_time(request["to"]),
         {:ok, level} <- parse_number(request["level"], 0, 62),
         true <- Bitwise.bsr(max(to - from, 0), level) <= @max_pixels,
         {:ok, max_items} <- parse_number(request["most"], 0, @max_pixels),
         :ok <- check_supported(store, :tracks, 6),
         {:ok, counts, tracks} <-
           store.module.tracks(store.state, info, from, to, level, max_items) do
      {:ok, term_reply({counts, tracks})}
    else
      false -> {:error, "the request covers more than #{@max_pixels} bins"}
      error -> error
    end
  end

  defp run_stream_operation(op, _store, _info, _request),
    do: {:error, "unknown operation: #{inspect(op)}"}

  defp streams_to_maps(infos) do
    for %StreamInfo{} = info <- infos do
      info |> Map.from_struct() |> Map.drop([:store_path, :type, :extra])
    end
  end

  defp check_supported(store, function, arity) do
    if Recording.implements?(store, function, arity),
      do: :ok,
      else:
        {:error,
         Error.new(:no_summary, "#{inspect(store.module)} does not support summaries",
           meta: %{none: true}
         )}
  end

  defp parse_time(n), do: parse_number(n, -0x7FFFFFFFFFFFFFFF, 0x7FFFFFFFFFFFFFFF)

  defp parse_number(n, min, max) when is_integer(n) and n >= min and n <= max, do: {:ok, n}
  defp parse_number(_n, min, max), do: {:error, "a number is not between #{min} and #{max}"}

  defp split_body(bytes) when byte_size(bytes) <= @part_bytes, do: [[1, bytes]]

  defp split_body(bytes) do
    <<part::binary-size(@part_bytes), rest::binary>> = bytes
    [[0, part] | split_body(rest)]
  end

  defp bad_request_error(why), do: Error.new(:bad_request, "the request is malformed", why: why)
end
