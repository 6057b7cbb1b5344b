defmodule Situ.Bridge.RawMessages do
  @moduledoc """
  Reads and writes the messages of MCAP files, ROS 1 bags and ROS 2 bags as they are: their bytes, the definition of
  their type, both times and their sequence number. So they can be copied, filtered, cut and merged without a change,
  also if Situ cannot interpret them, and between these formats if the other format allows their encoding.

      {:ok, count} = Situ.Bridge.RawMessages.copy(["monday.mcap", "tuesday.mcap"], "week.mcap", streams: ["/imu"])

      for message <- Situ.Bridge.RawMessages.stream(Situ.Store.open!("drive.bag")),
          do: {message.channel.topic, message.log_time, byte_size(message.bytes)}

  `decode/1` decodes a message when its value is needed. The verbs of `situ store` that create files (copy, crop,
  concat, split, save) use this module where they can.
  """
  # See docs/adr/0199-raw-messages-are-copied-as-they-are.md.
  alias Situ.Bridge.{Mcap, RawChannel, RawMessage, Ros}
  alias Situ.Bridge.Mcap.Codec
  alias Situ.Bridge.Raw.Merge
  alias Situ.{Error, Store}

  @readers %{
    Mcap => Mcap.RawReader,
    Ros.Bag => Ros.Bag.RawReader,
    Ros.Db3 => Ros.Db3.RawReader
  }
  @writers %{mcap: Mcap.Writer, bag: Ros.Bag.Writer, db3: Ros.Db3.Writer}
  @extensions %{".mcap" => :mcap, ".bag" => :bag, ".db3" => :db3}

  @selection [
    streams: [
      type: {:optional, {:list, :string}},
      default: nil,
      doc: "The names of the streams to read; default: all."
    ],
    from: [type: {:optional, :integer}, default: nil, doc: "The earliest log time, ns."],
    to: [type: {:optional, :integer}, default: nil, doc: "The latest log time, ns."],
    skip_damage: [
      type: :boolean,
      default: false,
      doc: "Skip messages that cannot be read; otherwise they are an error."
    ]
  ]
  @copying @selection ++
             [
               format: [
                 type: {:optional, {:in, [:mcap, :bag, :db3]}},
                 default: nil,
                 doc: "The format of the new file, whatever its extension."
               ],
               name: [
                 type: {:optional, :string},
                 default: nil,
                 doc: "The name of the file in the summary of a ROS 2 bag, if it will be renamed."
               ],
               order: [
                 type: {:optional, {:in, [:file, :time]}},
                 default: nil,
                 doc:
                   "The order of a single MCAP file's messages; other files are always in order of time."
               ],
               compression: [
                 type: {:optional, {:in, [:none, :lz4, :zstd]}},
                 default: nil,
                 doc: "The compression of MCAP files and bags (bags: `:none`, `:lz4`)."
               ],
               progress: [
                 type: {:fun, 1},
                 default: &__MODULE__.ignore_progress/1,
                 doc: "A function that is called with the number of messages written so far."
               ]
             ] ++ Keyword.take(Mcap.Options.file_options(), [:attachments, :metadata])

  @doc """
  Returns whether the messages of a recording can be read as they are: it is an MCAP file or a bag.
  """
  @spec readable?(Store.t()) :: boolean()
  def readable?(%Situ.Recording{module: module}), do: is_map_key(@readers, module)
  def readable?(_store), do: false

  @doc "Returns the channels of an opened MCAP file or bag. Error: `:not_raw` for other recordings."
  @spec channels(Store.t()) :: {:ok, [RawChannel.t()]} | {:error, Error.t()}
  def channels(store) do
    with {:ok, reader} <- fetch_reader(store), do: reader.list_channels(store.state)
  end

  defp fetch_reader(%Situ.Recording{module: module}) when is_map_key(@readers, module),
    do: {:ok, @readers[module]}

  defp fetch_reader(store) do
    {:error,
     Error.new(:not_raw, "#{store.path} has no raw messages",
       why: "only MCAP files and ROS bags store messages with the definitions of their types",
       fix: "read its values with `Situ.Store.messages/3`"
     )}
  end

  @doc """
  Returns the messages of a recording, or of several merged, lazily and in order of their log times. Messages with equal
  times are in the order of the recordings, then of the channels, then of the file. The stream raises a `Situ.Error`
  for damage.

  #{Situ.Options.docs(@selection)}
  """
  @spec stream(Store.t() | [Store.t()], keyword()) :: Enumerable.t()
  def stream(stores, opts \\ []) do
    opts = Situ.Options.validate!(opts, @selection)

    Stream.resource(
      fn ->
        stores |> List.wrap() |> open_sources(opts) |> Error.unwrap!() |> Merge.start(opts)
      end,
      fn merge ->
        case Merge.take(merge) do
          {:ok, nil, merge} -> {:halt, merge}
          {:ok, message, merge} -> {[message], merge}
          {:error, error} -> raise error
        end
      end,
      fn _merge -> :ok end
    )
  end

  # Returns `{reader, state, channel}` for each selected channel.
  defp open_sources(stores, opts) do
    with {:ok, sources} <- Error.map_ok(stores, &list_source(&1, opts)),
         do: {:ok, Enum.concat(sources)}
  end

  defp list_source(store, opts) do
    with {:ok, reader} <- fetch_reader(store),
         :ok <- check_damage(store, opts),
         {:ok, channels} <- reader.list_channels(store.state) do
      chosen = Enum.filter(channels, &(opts[:streams] == nil or &1.stream in opts[:streams]))
      {:ok, for(channel <- chosen, do: {reader, store.state, channel})}
    end
  end

  defp check_damage(store, opts) do
    case {opts[:skip_damage], Store.info(store).damage} do
      {false, [first | _]} -> {:error, damage_error(store, first)}
      _ -> :ok
    end
  end

  defp damage_error(store, first),
    do:
      Error.new(:damaged, "#{store.path} is damaged",
        why: to_string(first),
        fix: "copy what is readable with `skip_damage: true` (`--skip-damage`)"
      )

  @doc """
  Decodes a message as `Situ.Store` does: standard messages of ROS and Foxglove become Situ's types, others become maps,
  and messages of unknown encodings stay bytes. The error is a sentence.
  """
  @spec decode(RawMessage.t()) :: {:ok, term()} | {:error, String.t()}
  def decode(%RawMessage{channel: channel, bytes: bytes}) do
    {codec, _type, _note} = Codec.new(channel.encoding, channel.schema, channel.topic)
    Codec.decode(codec, bytes)
  end

  @doc """
  Copies recordings into one new file, merged in order of log times; each is a path or an opened recording. The
  extension of `path` selects the format: `.mcap`, `.bag` or `.db3`. Channels that are equal in all recordings
  become one channel. Attachments and metadata of MCAP files are copied into MCAP files. `left_out` is a list of
  sentences about data that the new file cannot hold.

  A single MCAP file is copied record by record (`Situ.Bridge.Mcap.copy/3`), which also keeps the order of the file.
  Error: `:not_raw` if a recording, or the format for the encoding of a channel, does not allow it.

  #{Situ.Options.docs(@copying)}
  """
  @spec copy([Store.t() | Path.t()], Path.t(), keyword()) ::
          {:ok, %{messages: non_neg_integer(), left_out: [String.t()]}} | {:error, Error.t()}
  def copy(sources, path, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @copying),
         {:ok, format} <- choose_format(path, opts[:format]),
         {:ok, stores} <- Error.map_ok(List.wrap(sources), &open_store/1),
         do: copy_stores(stores, format, path, opts)
  end

  defp open_store(path) when is_binary(path), do: Store.open(path)
  defp open_store(store), do: {:ok, store}

  defp choose_format(path, nil), do: fetch_format(path)
  defp choose_format(_path, format), do: {:ok, format}

  defp fetch_format(path) do
    with :error <- Map.fetch(@extensions, path |> Path.extname() |> String.downcase()) do
      {:error,
       Error.new(:not_raw, "#{path} cannot hold raw messages",
         fix: "name a file that ends in .mcap, .bag or .db3"
       )}
    end
  end

  defp copy_stores([%{module: Mcap} = store], :mcap, path, opts),
    do: Mcap.copy(store, path, opts |> Keyword.drop([:format, :name]) |> put_order())

  defp copy_stores(stores, format, path, opts) do
    writer = @writers[format]

    with {:ok, sources} <- open_sources(stores, opts),
         :ok <- check_channels(writer, path, sources),
         {:ok, attachments, metadata} <- read_extras(stores),
         {:ok, state} <- writer.create(path, file_options(format, opts)),
         {:ok, left_out} <- write_extras(format, state, {attachments, metadata}, opts),
         {:ok, state} <- write_sources(writer, state, sources, opts),
         {:ok, _} <- writer.finish(state),
         do: describe_copy(format, state, path, left_out)
  end

  # A program that renames the file calls `Ros.Db3.write_beside/1` then.
  defp describe_copy(:db3, %{name: name} = state, path, left_out) do
    renamed? = name != Path.basename(path)

    with :ok <- if(renamed?, do: :ok, else: Ros.Db3.write_beside(path)),
         do: {:ok, %{messages: state.count, left_out: left_out}}
  end

  defp describe_copy(_format, state, _path, left_out),
    do: {:ok, %{messages: state.count, left_out: left_out}}

  defp file_options(:db3, opts), do: Keyword.take(opts, [:name])

  defp file_options(_format, opts),
    do: for({:compression, value} when value != nil <- opts, do: {:compression, value})

  defp check_channels(writer, path, sources) do
    Enum.find_value(sources, :ok, fn {_reader, _state, channel} ->
      why = writer.refuse_channel(channel)
      why && {:error, refused_error(channel, path, why)}
    end)
  end

  defp refused_error(channel, path, why),
    do:
      Error.new(:not_raw, "the messages of #{channel.topic} cannot be copied into #{path}",
        why: why,
        fix: "write an MCAP file, or omit the topic"
      )

  @doc """
  Returns whether `copy/3` can write these streams of a recording (default: all) to a file of this format: `:mcap`,
  `:bag` or `:db3`.
  """
  @spec copyable?(Store.t(), atom(), [String.t()] | nil) :: boolean()
  def copyable?(store, format, streams \\ nil) do
    with true <- readable?(store) and is_map_key(@writers, format),
         {:ok, channels} <- channels(store) do
      channels
      |> Enum.filter(&(streams == nil or &1.stream in streams))
      |> Enum.all?(&(@writers[format].refuse_channel(&1) == nil))
    else
      _ -> false
    end
  end

  defp read_extras(stores) do
    extras =
      Error.map_ok(stores, fn %{module: module, state: state} ->
        with {:ok, attachments, metadata} <- @readers[module].read_extras(state),
             do: {:ok, {attachments, metadata}}
      end)

    with {:ok, extras} <- extras do
      {attachments, metadata} = Enum.unzip(extras)
      # The parts of a file that was split have the same attachments.
      {:ok, attachments |> Enum.concat() |> Enum.uniq(), metadata |> Enum.concat() |> Enum.uniq()}
    end
  end

  defp put_order(opts), do: Keyword.put(opts, :order, opts[:order] || :file)

  defp write_extras(:mcap, state, {attachments, metadata}, opts) do
    kept = Enum.reject(metadata, fn {name, _} -> is_map_key(opts[:metadata], name) end)
    attachments = attachments ++ opts[:attachments]
    extras = [attachments: attachments, metadata: kept ++ Map.to_list(opts[:metadata])]
    with :ok <- Mcap.Writer.write_extras(state.ref, extras, state.path), do: {:ok, []}
  end

  defp write_extras(format, _state, {attachments, metadata}, _opts) do
    {:ok,
     for {what, [_ | _] = list} <- [{"attachments", attachments}, {"metadata records", metadata}] do
       "#{length(list)} #{what}, because files of the kind #{format} have none"
     end}
  end

  @doc false
  def ignore_progress(_written), do: :ok

  defp write_sources(writer, state, sources, opts) do
    # All channels are added, also those without messages.
    with {:ok, {state, ids}} <- add_channels(writer, state, sources),
         do: write_messages(sources |> Merge.start(opts), writer, state, ids, opts[:progress])
  end

  defp add_channels(writer, state, sources) do
    Enum.reduce_while(sources, {:ok, {state, %{}}}, fn {_, _, channel}, {:ok, {state, ids}} ->
      identity = RawChannel.identity(channel)

      with false <- is_map_key(ids, identity),
           {:ok, id, state} <- writer.add_channel(state, channel) do
        {:cont, {:ok, {state, Map.put(ids, identity, id)}}}
      else
        true -> {:cont, {:ok, {state, ids}}}
        error -> {:halt, error}
      end
    end)
  end

  defp write_messages(merge, writer, state, ids, progress) do
    with {:ok, message, merge} when message != nil <- Merge.take(merge),
         {:ok, state} <- write_message(writer, state, ids, message) do
      if rem(state.count, 1_000) == 0, do: progress.(state.count)
      write_messages(merge, writer, state, ids, progress)
    else
      {:ok, nil, _merge} -> {:ok, state}
      error -> error
    end
  end

  defp write_message(writer, state, ids, message) do
    id = Map.fetch!(ids, RawChannel.identity(message.channel))
    row = {message.log_time, message.publish_time, message.sequence, message.bytes}
    writer.write_row(state, id, row)
  end
end
