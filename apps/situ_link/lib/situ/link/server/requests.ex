defmodule Situ.Link.Server.Requests do
  @moduledoc """
  Handles the requests of clients to a recording (`{:request, id, map}`) and builds the bodies of the replies. The
  client side is the reader `Situ.Link.Recording`.

  | `op` | further keys | reply |
  |---|---|---|
  | `open` | | info, with `version` |
  | `streams`; `stream` | `stream` | list of maps; one |
  | `seek`, `count` | `stream`, `time` | ordinal, number |
  | `read` | `stream`, `ordinal`, `to`, `limit`, `exact`, `envelopes`, `skip_damage` | 64 bits of ordinal, batches |
  | `summary`, `tracks` | `stream`, `from`, `to`, `pixels` or `level` and `most` | as in `Situ.Recording` |
  | `gaps`; `missing_files` | `stream`, `least` | lists |
  | `await` | `known` | `{:published \| :ended, n}`, once there is more than `known` |

  Every request except `open` contains the `version` returned by `open`. All replies except those to `read` are external
  terms, which the client reads with the checked decoder of stores. A body is sent in segments: each begins with the
  byte 0, the last one with 1. The byte 2 precedes an error as JSON.
  """
  # See docs/adr/0115-remote-recordings-answer-requests.md.
  alias Situ.{Error, JSON}
  alias Situ.Link.Wire.{Batch, Handshake}
  alias Situ.Recording
  alias Situ.Store.{Query, StreamInfo}

  # Limits for the messages in one reply. The second one applies if the client wants exactly as many as it asked for.
  @most 4_096
  @most_exact 16
  @most_pixels 100_000
  @piece 1024 * 1024

  @doc """
  Handles a request. Returns the segments of the reply or, for `await`, the number above which the client wants to be
  notified.
  """
  @spec handle_request(Recording.t(), map()) :: {:ok, [iodata()]} | {:await, non_neg_integer()}
  def handle_request(%Recording{} = store, %{"op" => "await"} = asked) do
    with {:ok, known} <- parse_number(asked["known"], 0, 0xFFFFFFFFFFFF),
         true <- Recording.implements?(store, :notify, 4) do
      {:await, known}
    else
      _ -> {:ok, term_reply({:ended, 0})}
    end
  end

  def handle_request(%Recording{} = store, asked) do
    case run_operation(asked["op"], store, asked) do
      {:ok, body} -> {:ok, body}
      {:error, %Error{} = error} -> {:ok, error |> hide_path(store) |> error_reply()}
      {:error, why} -> {:ok, error_reply(bad_request_error(why))}
    end
  rescue
    error in Error -> {:ok, error |> hide_path(store) |> error_reply()}
  end

  # Clients must not see paths of this machine.
  defp hide_path(error, store) do
    hide = &(&1 && String.replace(&1, store.path, Path.basename(store.path)))
    %{error | what: hide.(error.what), why: hide.(error.why), fix: hide.(error.fix)}
  end

  @doc "Builds the reply for an error."
  @spec error_reply(Error.t()) :: [iodata()]
  def error_reply(%Error{} = error), do: [[2, JSON.encode(Handshake.error_to_map(error))]]

  @doc "Builds the reply for a term."
  @spec term_reply(term()) :: [iodata()]
  def term_reply(term), do: term |> :erlang.term_to_binary() |> split_body()

  defp run_operation("open", store, _asked) do
    info = Query.info(store)
    known = [:name, :version, :created, :closed?, :live?, :volatile?, :entries, :damage, :id]
    {:ok, info |> Map.take(known) |> term_reply()}
  end

  defp run_operation("streams", store, _asked),
    do: {:ok, store |> Query.streams() |> streams_to_maps() |> term_reply()}

  defp run_operation("missing_files", store, _asked),
    do: {:ok, store |> Query.missing_files() |> term_reply()}

  defp run_operation(op, store, %{"stream" => name} = asked) when is_binary(name) do
    with {:ok, info} <- Query.stream_info(store, name),
         do: run_stream_operation(op, store, info, asked)
  end

  defp run_operation(op, _store, _asked),
    do: {:error, "the operation #{inspect(op)} needs a stream"}

  defp run_stream_operation("stream", _store, info, _asked),
    do: {:ok, [info] |> streams_to_maps() |> term_reply()}

  defp run_stream_operation("count", store, info, _asked),
    do: {:ok, store |> Query.count(info) |> term_reply()}

  defp run_stream_operation("seek", store, info, asked) do
    with {:ok, time} <- parse_time(asked["time"]),
         {:ok, ordinal} <- Query.seek_ordinal(store, info, time),
         do: {:ok, term_reply(ordinal)}
  end

  defp run_stream_operation("gaps", store, info, asked) do
    with {:ok, least} <- parse_time(asked["least"]),
         do: {:ok, store |> Query.gaps(info, least) |> term_reply()}
  end

  defp run_stream_operation("read", store, info, asked) do
    exact? = asked["exact"] == true
    flags = [exact: exact?, envelopes: asked["envelopes"] == true]
    opts = [skip_damage: asked["skip_damage"] == true] ++ flags

    with {:ok, ordinal} <- parse_number(asked["ordinal"], 0, 0xFFFFFFFFFFFFFF),
         {:ok, to} <-
           if(asked["to"] == nil, do: {:ok, :unbounded}, else: parse_time(asked["to"])),
         {:ok, limit} <- parse_number(asked["limit"], 1, 0xFFFFFFFF),
         limit = min(limit, if(exact?, do: @most_exact, else: @most)),
         {:ok, messages, next} <- Query.read_batch(store, info, ordinal, to, limit, opts) do
      batches =
        for {_, _, _, payload} <- Batch.encode(messages),
            do: [<<IO.iodata_length(payload)::32>>, payload]

      {:ok, split_body(IO.iodata_to_binary([<<next::64>> | batches]))}
    end
  end

  defp run_stream_operation("summary", store, info, asked) do
    with {:ok, from} <- parse_time(asked["from"]),
         {:ok, to} <- parse_time(asked["to"]),
         {:ok, pixels} <- parse_number(asked["pixels"], 1, @most_pixels),
         :ok <- check_supported(store, :summary, 5),
         {:ok, width, bins} <- store.module.summary(store.state, info, from, to, pixels),
         do: {:ok, term_reply({width, bins})}
  end

  defp run_stream_operation("tracks", store, info, asked) do
    with {:ok, from} <- parse_time(asked["from"]),
         {:ok, to} <- parse_time(asked["to"]),
         {:ok, level} <- parse_number(asked["level"], 0, 62),
         true <- Bitwise.bsr(max(to - from, 0), level) <= @most_pixels,
         {:ok, most} <- parse_number(asked["most"], 0, @most_pixels),
         :ok <- check_supported(store, :tracks, 6),
         {:ok, counts, tracks} <- store.module.tracks(store.state, info, from, to, level, most) do
      {:ok, term_reply({counts, tracks})}
    else
      false -> {:error, "the request covers more than #{@most_pixels} bins"}
      error -> error
    end
  end

  defp run_stream_operation(op, _store, _info, _asked),
    do: {:error, "unknown operation: #{inspect(op)}"}

  defp streams_to_maps(infos) do
    for %StreamInfo{} = info <- infos do
      info |> Map.from_struct() |> Map.drop([:store_path, :type, :extra])
    end
  end

  defp check_supported(store, function, arity) do
    if function_exported?(store.module, function, arity),
      do: :ok,
      else:
        {:error,
         Error.new(:no_summary, "#{inspect(store.module)} does not support summaries",
           meta: %{none: true}
         )}
  end

  defp parse_time(n), do: parse_number(n, -0x7FFFFFFFFFFFFFFF, 0x7FFFFFFFFFFFFFFF)

  defp parse_number(n, least, most) when is_integer(n) and n >= least and n <= most, do: {:ok, n}
  defp parse_number(_n, least, most), do: {:error, "a number is not between #{least} and #{most}"}

  defp split_body(bytes) when byte_size(bytes) <= @piece, do: [[1, bytes]]

  defp split_body(bytes) do
    <<piece::binary-size(@piece), rest::binary>> = bytes
    [[0, piece] | split_body(rest)]
  end

  defp bad_request_error(why), do: Error.new(:bad_request, "the request is malformed", why: why)
end
