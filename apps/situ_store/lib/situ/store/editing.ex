defmodule Situ.Store.Editing do
  @moduledoc false
  # Changes individual messages of a recording. Called through `Situ.Store.edit/4`; the original
  # is only read.
  alias Situ.{Error, Message}

  alias Situ.Store.{
    Copying,
    Draft,
    NativeErrors,
    Query,
    StreamInfo,
    Transfer,
    VideoCoder,
    Writer
  }

  @options [
    add: [
      type: {:list, {:tuple, [:string, :keyword]}},
      default: [],
      doc:
        "New streams as `{name, options}`, see `Situ.Store.Writer.stream/3`. Edits may fill them."
    ],
    compression: [
      type: {:in, [:none, :lz4, :zstd]},
      doc: "The compression of all streams. Default: as in the original."
    ],
    skip_damage: [type: :boolean, default: true, doc: "Skip damaged chunks."],
    progress: [type: {:fun, 2}, doc: "Called as `fun.(done, total)` with message counts."],
    versioned: [type: :boolean, default: true, doc: "Create a subfolder `NAME.NNNN`."]
  ]

  @spec edit_options() :: Situ.Options.schema()
  def edit_options, do: @options

  @spec edit(
          Path.t(),
          Path.t() | {String.t(), Path.t()},
          %{String.t() => [Situ.Store.edit()]},
          keyword()
        ) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def edit(from, to, edits, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @options),
         {:ok, store} <- Query.open(from),
         infos = Query.streams(store),
         added = Enum.map(opts[:add], &new_stream/1),
         :ok <- check_edits(edits, infos ++ Enum.map(added, &elem(&1, 0)), store),
         :ok <- check_video(edits, infos, store) do
      build_edited_store(to, store, infos, added, edits, opts)
    end
  end

  defp new_stream({name, options}),
    do: {%StreamInfo{id: -1, name: name, type: options[:type] || :any}, options}

  defp check_edits(edits, infos, store) do
    names = Enum.map(infos, & &1.name)

    case Map.keys(edits) -- names do
      [] -> Enum.find_value(infos, :ok, &find_type_mismatch(&1, edits[&1.name] || []))
      [name | _] -> {:error, NativeErrors.no_stream_error(name, names, store.path)}
    end
  end

  # Images of a video refer to each other, so a single one cannot be replaced.
  defp check_video(edits, infos, store) do
    edited = Enum.filter(infos, &((edits[&1.name] || []) != []))

    case Enum.find(edited, &VideoCoder.stored_as_video?(store, &1)) do
      nil ->
        :ok

      info ->
        {:error,
         Error.new(:not_editable, "single images of #{inspect(info.name)} cannot be changed",
           why: "they are stored as video, where images refer to each other",
           fix: "put the new images into another stream (add:), or crop the recording"
         )}
    end
  end

  # An edit must not violate the stream's declared type.
  defp find_type_mismatch(info, edits) do
    wrong = &(elem(&1, 0) == :upsert and not Situ.Type.valid_value?(info.type, elem(&1, 2)))

    with {:upsert, time, data} <- Enum.find(edits, wrong) do
      {:error,
       Error.new(:type_mismatch, "#{inspect(data, limit: 5)} does not fit #{inspect(info.name)}",
         why: "the stream is of type #{inspect(info.type)}",
         fix: "pass a value of that type for #{Situ.Time.to_iso8601(time)}"
       )}
    end
  end

  defp build_edited_store(to, store, infos, added, edits, opts) do
    report = Copying.progress_reporter(infos, opts)

    to
    |> Copying.resolve_target()
    |> Draft.build_store(Copying.put_store_defaults(opts, infos), fn writer ->
      with :ok <-
             each_ok(
               infos,
               &write_edited_stream(writer, {store, &1}, sort_edits(edits[&1.name]), opts, report)
             ),
           do:
             each_ok(added, fn {info, options} ->
               write_new_stream(writer, info, options, edits[info.name])
             end)
    end)
  end

  defp each_ok(list, fun) do
    Enum.reduce_while(list, :ok, fn element, :ok ->
      case fun.(element) do
        :ok -> {:cont, :ok}
        error -> {:halt, error}
      end
    end)
  end

  # If several edits have the same time, the last one wins.
  defp sort_edits(edits) do
    (edits || [])
    |> Enum.reverse()
    |> Enum.uniq_by(&elem(&1, 1))
    |> Enum.sort_by(&elem(&1, 1))
  end

  defp write_new_stream(writer, info, options, edits) do
    messages = for {:upsert, time, data} <- sort_edits(edits), do: build_message(time, data)

    with {:ok, stream} <- Writer.stream(writer, info.name, options),
         {:ok, _} <- Writer.append(stream, messages),
         do: :ok
  end

  defp write_edited_stream(writer, {_, info} = source, edits, opts, report) do
    with {:ok, transfer} <- Transfer.open_stream(writer, info, [source], opts, report),
         {:ok, transfer, ordinal} <- merge_edits(transfer, source, edits),
         {:ok, transfer, _} <- Transfer.transfer_messages(transfer, source, ordinal, :unbounded),
         do: Transfer.close_stream(transfer, closing_time(info.closed, edits))
  end

  # Inserting messages after the stream's end moves its end.
  defp closing_time(nil, _edits), do: nil
  defp closing_time(time, edits), do: Enum.max([time | for({:upsert, at, _} <- edits, do: at)])

  # Messages between two edits are copied unchanged.
  defp merge_edits(transfer, source, edits) do
    Enum.reduce_while(edits, {:ok, transfer, 0}, fn edit, {:ok, transfer, ordinal} ->
      with {:ok, transfer, next} <-
             Transfer.transfer_messages(transfer, source, ordinal, elem(edit, 1) - 1),
           old = find_message_at(source, next, elem(edit, 1)),
           {:ok, transfer} <- Transfer.append_messages(transfer, apply_edit(edit, old)) do
        {:cont, {:ok, transfer, if(old, do: next + 1, else: next)}}
      else
        error -> {:halt, error}
      end
    end)
  end

  defp find_message_at({store, info}, ordinal, time) do
    case Query.at(store, info, ordinal) do
      {:ok, %{originating_time: ^time} = message} -> message
      _none_or_damaged -> nil
    end
  end

  defp apply_edit({:delete, _}, _old), do: []
  defp apply_edit({:upsert, _, data}, %Message{} = old), do: [%{old | data: data}]
  defp apply_edit({:upsert, time, data}, nil), do: [build_message(time, data)]

  defp build_message(time, data),
    do: %Message{data: data, originating_time: time, creation_time: time, sequence_id: 0}
end
