defmodule Situ.Store.Editing do
  @moduledoc """
  Changing single messages of a recording. Called through `Situ.Store.edit/4`; the original is only read.
  """
  alias Situ.{Error, Message, Store}
  alias Situ.Store.Copying

  @type edit :: {:upsert, Situ.Time.t(), term()} | {:delete, Situ.Time.t()}

  @doc """
  A new store with edits applied by exact originating time: `edits` is a map of stream names to
  `[{:upsert, time, data} | {:delete, time}]`. An upsert replaces the message of that time or inserts one. Options as `Situ.Store.copy/3`, and
  `add: [{name, writer_stream_options}]` adds streams (edits may fill them).
  """
  @spec edit(Path.t(), Path.t() | {String.t(), Path.t()}, %{String.t() => [edit()]}, keyword()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def edit(from, to, edits, opts \\ []) do
    with {:ok, store} <- Store.open(from),
         infos = Store.streams(store),
         added = Enum.map(opts[:add] || [], &new_stream/1),
         :ok <- known(edits, infos ++ Enum.map(added, &elem(&1, 0)), store) do
      build(to, store, infos, added, edits, opts)
    end
  end

  defp new_stream({name, options}),
    do: {%Store.StreamInfo{id: -1, name: name, type: options[:type] || :any}, options}

  defp known(edits, infos, store) do
    names = Enum.map(infos, & &1.name)

    case Map.keys(edits) -- names do
      [] ->
        :ok

      [name | _] ->
        {:error,
         Error.new(:no_stream, "no stream #{inspect(name)} in #{store.path}",
           fix: "streams: " <> Enum.join(names, ", ")
         )}
    end
  end

  defp build(to, store, infos, added, edits, opts) do
    {name, root} = Copying.target(to)

    with {:ok, writer} <- Store.Writer.create(name, root, Keyword.take(opts, [:versioned])) do
      olds =
        Enum.map(infos, &{&1, Copying.stream_options(&1, [{store, &1}], opts), source(store, &1)})

      news = Enum.map(added, fn {info, options} -> {info, options, []} end)

      result =
        Enum.reduce_while(olds ++ news, :ok, fn {info, options, messages}, :ok ->
          case write(writer, info, options, messages, sorted(edits[info.name] || [])) do
            {:ok, _} -> {:cont, :ok}
            error -> {:halt, error}
          end
        end)

      with :ok <- result, :ok <- Store.Writer.close(writer) do
        {:ok, writer.path}
      else
        {:error, _} = error ->
          Store.Writer.close(writer)
          Store.delete(writer.path)
          error
      end
    end
  end

  defp source(store, info), do: Store.messages(store, info, skip_damage: true)

  # The last edit of a time is the one meant.
  defp sorted(edits) do
    edits |> Enum.reverse() |> Enum.uniq_by(&elem(&1, 1)) |> Enum.sort_by(&elem(&1, 1))
  end

  defp write(writer, info, options, messages, edits) do
    with {:ok, stream} <- Store.Writer.stream(writer, info.name, options) do
      messages
      |> Stream.transform(fn -> edits end, &merge/2, &rest/1, fn _ -> :ok end)
      |> Stream.chunk_every(1_000)
      |> Enum.reduce_while({:ok, stream}, fn batch, {:ok, stream} ->
        case Store.Writer.append(stream, batch) do
          {:ok, stream} -> {:cont, {:ok, stream}}
          error -> {:halt, error}
        end
      end)
      |> close(info)
    end
  end

  defp close({:ok, stream}, %{closed: nil}), do: {:ok, stream}
  defp close({:ok, stream}, %{closed: time}), do: Store.Writer.close_stream(stream, time)
  defp close(error, _info), do: error

  defp merge(%Message{originating_time: time} = message, edits) do
    {before, edits} = Enum.split_while(edits, &(elem(&1, 1) < time))

    {here, edits} =
      case edits do
        [{:upsert, ^time, data} | edits] -> {[%{message | data: data}], edits}
        [{:delete, ^time} | edits] -> {[], edits}
        _ -> {[message], edits}
      end

    {inserted(before) ++ here, edits}
  end

  defp rest(edits), do: {inserted(edits), []}

  defp inserted(edits) do
    for {:upsert, time, data} <- edits,
        do: %Message{data: data, originating_time: time, creation_time: time, sequence_id: 0}
  end
end
