defmodule Situ.Bridge.Recorder.StoreExport do
  @moduledoc false
  # Exports a recording to a file of another format: the messages of all streams, merged by time.
  alias Situ.Bridge.Foxglove.Messages
  alias Situ.Bridge.Ros.{Definition, Library}
  alias Situ.Bridge.Mcap
  alias Situ.Bridge.Mcap.ExtraFields
  alias Situ.{Error, Store}
  alias Situ.Store.{Query, StreamInfo, VideoCoder}

  def export_store(module, store, path, opts) do
    {selection, opts} = Keyword.pop(opts, :streams)
    {read_opts, opts} = Keyword.split(opts, [:from, :to, :skip_damage])
    {progress, opts} = Keyword.pop(opts, :progress, fn _written -> :ok end)
    {topic, opts} = Keyword.split(opts, Keyword.keys(module.topic_options()))
    streams = Store.streams(store)
    infos = Map.new(streams, &{&1.name, &1})
    topics = Map.new(streams, &{&1.name, put_imported_type(topic, &1, module)})

    job = %{
      module: module,
      path: path,
      opts: opts,
      topics: topics,
      infos: infos,
      progress: progress,
      heads: fn ->
        read_opts = read_opts ++ [video?: video_allowed?(module, topic[:encoding])]
        build_heads(store, selection, read_opts, topic[:encoding])
      end
    }

    write_file(job, MapSet.new())
  end

  # Unless the caller sets the encoding, a stream's first message determines it. If a later message does not fit that
  # encoding, the export restarts with the stream as JSON, since a topic has a single encoding.
  defp write_file(job, json) do
    with {:ok, writer} <- job.module.create(job.path, job.opts) do
      case copy_streams(writer, job, json) do
        {:ok, writer} ->
          with {:ok, _} <- job.module.finish(writer), do: {:ok, writer.count}

        {:error, name, error} ->
          # An open writer would write its index into the file that the next one creates.
          _ = job.module.finish(writer)
          retry_as_json(job, json, name, error)
      end
    end
  end

  defp retry_as_json(job, json, name, %{code: :not_writable} = error) do
    if json_allowed?(job, name) and not MapSet.member?(json, name),
      do: write_file(job, MapSet.put(json, name)),
      else: {:error, error}
  end

  defp retry_as_json(_job, _json, _name, error), do: {:error, error}

  defp json_allowed?(job, name) do
    topic = Map.fetch!(job.topics, name)

    Keyword.has_key?(job.module.topic_options(), :encoding) and topic[:type] == nil and
      topic[:encoding] in [nil, :auto]
  end

  defp copy_streams(writer, job, json) do
    topics =
      Map.new(job.topics, fn {name, topic} ->
        if name in json, do: {name, {[encoding: :json], true}}, else: {name, {topic, false}}
      end)

    copy_heads(job.heads.(), writer, job, topics)
  rescue
    error in Error -> {:error, nil, error}
  end

  defp copy_heads([], writer, _job, _topics), do: {:ok, writer}

  defp copy_heads([{_time, name, [message | rest], next, stream} | heads], writer, job, topics) do
    %{^name => topic} = topics

    case copy_message(message, name, topic, writer, job) do
      {:ok, writer} ->
        if rem(writer.count, 1_000) == 0, do: job.progress.(writer.count)
        rest |> put_head(name, next, stream, heads) |> copy_heads(writer, job, topics)

      {:error, error} ->
        {:error, name, error}
    end
  end

  defp copy_message(message, name, {topic, json?}, writer, job) do
    with :ok <- check_present(message.data, job, name, json?),
         do: job.module.write(writer, name, message, topic)
  end

  # ROS has no missing numbers or strings: `nil` would become 0 or "".
  defp check_present(nil, job, name, false) do
    if json_allowed?(job, name) and not struct_type?(job.infos[name].type),
      do: {:error, Error.new(:not_writable, "a message of #{name} is nil")},
      else: :ok
  end

  defp check_present(_data, _job, _name, _json?), do: :ok

  defp struct_type?({:optional, type}), do: struct_type?(type)
  defp struct_type?(type), do: is_atom(type) and match?("Elixir." <> _, Atom.to_string(type))

  # Messages that keep their ROS or Foxglove type are read as maps, so that the export includes all their fields.
  defp with_all_fields(%{module: module, state: state} = store, type, encoding) do
    if known_type?(type, encoding) and function_exported?(module, :as_maps, 1),
      do: %{store | state: module.as_maps(state)},
      else: store
  end

  # The metadata of an imported stream holds its original type.
  defp put_imported_type(topic, info, module) do
    with nil <- topic[:type],
         {:ok, %{"schema" => %{"name" => name} = schema}} <- StreamInfo.metadata(info),
         {:ok, opts} <- imported_options(name, schema, module, topic[:encoding] || :auto) do
      opts ++ Keyword.drop(topic, [:encoding])
    else
      _ -> put_type(topic, info.type_name)
    end
  end

  defp imported_options(name, %{"encoding" => "ros1msg", "definition" => text}, _module, encoding)
       when encoding in [:auto, :ros1],
       do: {:ok, [type: name, definition: text]}

  defp imported_options(
         name,
         %{"encoding" => "ros2msg", "definition" => text},
         Mcap.Writer,
         encoding
       )
       when encoding in [:auto, :cdr],
       do: {:ok, [type: name, definition: text, encoding: :cdr]}

  defp imported_options(
         name,
         %{"encoding" => "protobuf", "definition" => set},
         Mcap.Writer,
         encoding
       )
       when encoding in [:auto, :protobuf],
       do: {:ok, [type: name, definition: set, encoding: :protobuf]}

  defp imported_options(_name, _schema, _module, _encoding), do: :error

  defp put_type(topic, type) do
    if topic[:type] == nil and known_type?(type, topic[:encoding]),
      do: Keyword.put(topic, :type, Definition.strip_kind(type)),
      else: topic
  end

  defp known_type?(type, :protobuf), do: Messages.message_type?(type)
  defp known_type?(_type, :json), do: false
  defp known_type?(type, _ros), do: Library.fetch(Definition.strip_kind(type)) != :error

  # Returns each stream with its next messages, ordered by time: `{time, name, messages, next_ordinal, stream}`.
  defp build_heads(store, selection, read_opts, encoding) do
    streams = Store.streams(store)
    extras = ExtraFields.find_streams(streams)
    extra_names = for {_, %StreamInfo{name: name}} <- extras, do: name

    for info <- streams,
        selection == nil or info.name in selection,
        info.name not in extra_names,
        info.count > 0,
        reduce: [] do
      heads ->
        {first, packets?} = find_start(store, info, read_opts)
        extra = {info, extras[info.name]}
        opts = read_opts |> Keyword.delete(:video?) |> Keyword.put(:packets, packets?)
        stream = {with_all_fields(store, info.type_name, encoding), extra, opts}
        put_head([], info.name, first, stream, heads)
    end
  end

  # Compressed video begins with a key frame.
  defp find_start(store, info, read_opts) do
    first = first_ordinal(store, info, read_opts[:from])

    if read_opts[:video?] and foxglove_video?(store, info),
      do: {VideoCoder.find_key(store, info, first), true},
      else: {first, false}
  end

  # Foxglove has a message for compressed video. In ROS, images are written one by one.
  defp video_allowed?(module, encoding),
    do: module == Mcap.Writer and encoding in [nil, :auto, :protobuf]

  # Foxglove's message has no VP8.
  defp foxglove_video?(store, info) do
    VideoCoder.stored_as_video?(store, info) and
      match?(
        {:ok, %{data: %{codec: codec}}} when codec != :vp8,
        Store.at(store, info, 0, packets: true)
      )
  end

  defp first_ordinal(_store, _info, nil), do: 0

  defp first_ordinal(store, info, from) do
    case Store.ordinal(store, info, from) do
      {:ok, ordinal} -> ordinal
      {:error, error} -> raise error
    end
  end

  defp put_head([message | _] = messages, name, next, stream, heads),
    do:
      insert_head(
        heads,
        message.originating_time,
        {message.originating_time, name, messages, next, stream}
      )

  defp put_head([], name, next, stream, heads) do
    case read_messages(stream, next) do
      {[], _next} -> heads
      {messages, next} -> put_head(messages, name, next, stream, heads)
    end
  end

  # Inserts the stream after other streams with the same time, so that they alternate.
  defp insert_head([{other, _, _, _, _} = head | heads], time, new) when other <= time,
    do: [head | insert_head(heads, time, new)]

  defp insert_head(heads, _time, new), do: [new | heads]

  defp read_messages({store, {info, extra}, read_opts}, from) do
    to = read_opts[:to] || :unbounded

    case Query.read_batch(store, info, from, to, 100, read_opts) do
      {:ok, [], next} -> {[], next}
      {:ok, messages, next} -> {ExtraFields.join_extra(messages, store, extra, from), next}
      {:error, error} -> raise error
    end
  end
end
