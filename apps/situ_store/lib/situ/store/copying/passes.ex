defmodule Situ.Store.Copying.Passes do
  @moduledoc false
  # Writes the streams of a copy, in as few passes over the originals as their readers allow.
  alias Situ.Error
  alias Situ.Store.{Query, StreamInfo, Transfer, VideoCoder, Writer}

  @earliest -0x8000000000000000
  @latest 0x7FFFFFFFFFFFFFFF

  @doc "Writes streams, each from the sources of its messages. Calls `report.(n)` for every `n` messages."
  @spec write_streams(
          Writer.t(),
          [{StreamInfo.t(), [Transfer.source()]}],
          keyword(),
          (pos_integer() -> any())
        ) :: :ok | {:error, Error.t()}
  def write_streams(writer, parts, opts, report) do
    parts
    |> Enum.chunk_by(&pass_key/1)
    |> each_ok(&write_pass(writer, &1, opts, report))
  end

  # Streams that can be read in one pass over the same files are written together; every other stream is separate.
  defp pass_key({info, sources}) do
    if one_pass?(sources),
      do: {:files, for({store, _} <- sources, do: store.path)},
      else: {:stream, info.name}
  end

  defp one_pass?(sources), do: Enum.all?(sources, fn {store, _} -> Transfer.one_pass?(store) end)

  defp write_pass(writer, parts, opts, report) do
    with {:ok, transfers} <- open_transfers(writer, parts, opts, report),
         {:ok, transfers} <- transfer_streams(transfers, Enum.map(parts, &elem(&1, 1)), opts) do
      transfers
      |> Enum.zip(parts)
      |> each_ok(fn {transfer, {info, _}} ->
        Transfer.close_stream(transfer, info.closed && min_time(info.closed, opts[:to]))
      end)
    end
  end

  defp open_transfers(writer, parts, opts, report) do
    Error.map_ok(parts, fn {info, sources} ->
      Transfer.open_stream(writer, info, sources, opts, report)
    end)
  end

  defp transfer_streams(transfers, [first | _] = sources, opts) do
    if one_pass?(first),
      do: take_passes(transfers, Enum.zip_with(sources, & &1), opts),
      else: take_messages(transfers, sources, opts)
  end

  # Makes one pass over each file for all streams in it.
  defp take_passes(transfers, files, opts) do
    interval = {clamp(opts[:from] || @earliest), clamp(opts[:to] || @latest)}

    with :ok <- each_ok(files, &Transfer.transfer_together(Enum.zip(transfers, &1), interval)),
         do: {:ok, transfers}
  end

  defp take_messages([transfer], [sources], opts) do
    taken =
      Enum.reduce_while(sources, {:ok, transfer}, fn {store, info} = source, {:ok, transfer} ->
        with {:ok, first} <- seek_first(store, info, opts[:from]),
             {:ok, transfer, _} <-
               Transfer.transfer_messages(transfer, source, first, opts[:to] || :unbounded) do
          {:cont, {:ok, transfer}}
        else
          error -> {:halt, error}
        end
      end)

    with {:ok, transfer} <- taken, do: {:ok, [transfer]}
  end

  defp each_ok(list, fun) do
    Enum.reduce_while(list, :ok, fn element, :ok ->
      case fun.(element) do
        {:error, error} -> {:halt, {:error, error}}
        _ok -> {:cont, :ok}
      end
    end)
  end

  defp seek_first(_store, _info, nil), do: {:ok, 0}

  # A copy of a video begins with a key frame, because the images after it cannot be decoded without it.
  defp seek_first(store, info, from) do
    with {:ok, ordinal} <- Query.seek_ordinal(store, info, from),
         do: {:ok, VideoCoder.find_key(store, info, ordinal)}
  end

  defp clamp(time), do: time |> max(@earliest) |> min(@latest)

  defp min_time(time, nil), do: time
  defp min_time(time, to), do: min(time, to)
end
