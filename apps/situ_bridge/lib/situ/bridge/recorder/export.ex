defmodule Situ.Bridge.Recorder.Export do
  @moduledoc false
  # Exports a recording to a file of another format: the messages of all streams, merged by time.
  alias Situ.Bridge.Foxglove.Messages
  alias Situ.Bridge.Ros.{Definition, Library}
  alias Situ.Bridge.Mcap
  alias Situ.Bridge.Mcap.Extra
  alias Situ.{Error, Store}
  alias Situ.Store.StreamInfo

  def export(module, store, path, opts) do
    {wanted, opts} = Keyword.pop(opts, :streams)
    {reading, opts} = Keyword.split(opts, [:from, :to, :skip_damage])
    {progress, opts} = Keyword.pop(opts, :progress, fn _written -> :ok end)
    {topic, opts} = Keyword.split(opts, Keyword.keys(module.topic_options()))
    streams = Store.streams(store)
    infos = Map.new(streams, &{&1.name, &1})
    topics = Map.new(streams, &{&1.name, typed(topic, &1, module)})

    job = %{
      module: module,
      path: path,
      opts: opts,
      topics: topics,
      infos: infos,
      progress: progress,
      heads: fn -> heads(store, wanted, reading, topic[:encoding]) end
    }

    written(job, MapSet.new())
  end

  # Unless the caller sets the encoding, a stream's first message determines it. If a later message does not fit that
  # encoding, the export restarts with the stream as JSON, since a topic has a single encoding.
  defp written(job, json) do
    with {:ok, writer} <- job.module.create(job.path, job.opts) do
      case copy(writer, job, json) do
        {:ok, writer} ->
          with {:ok, _} <- job.module.finish(writer), do: {:ok, writer.count}

        {:error, name, %{code: :not_writable} = error} ->
          if free?(job, name) and not MapSet.member?(json, name),
            do: written(job, MapSet.put(json, name)),
            else: {:error, error}

        {:error, _name, error} ->
          {:error, error}
      end
    end
  end

  defp free?(job, name) do
    topic = Map.fetch!(job.topics, name)

    Keyword.has_key?(job.module.topic_options(), :encoding) and topic[:type] == nil and
      topic[:encoding] in [nil, :auto]
  end

  defp copy(writer, job, json) do
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
    with :ok <- there(message.data, job, name, json?),
         do: job.module.write(writer, name, message, topic)
  end

  # ROS has no missing numbers or strings: `nil` would become 0 or "".
  defp there(nil, job, name, false) do
    if free?(job, name) and not struct?(job.infos[name].type),
      do: {:error, Error.new(:not_writable, "a message of #{name} is nil")},
      else: :ok
  end

  defp there(_data, _job, _name, _json?), do: :ok

  defp struct?({:optional, type}), do: struct?(type)
  defp struct?(type), do: is_atom(type) and match?("Elixir." <> _, Atom.to_string(type))

  # Messages that keep their ROS or Foxglove type are read as maps, so that the export includes all their fields.
  defp whole(%{module: module, state: state} = store, type, encoding) do
    if known?(type, encoding) and function_exported?(module, :as_maps, 1),
      do: %{store | state: module.as_maps(state)},
      else: store
  end

  # The metadata of an imported stream holds its original type.
  defp typed(topic, info, module) do
    with nil <- topic[:type],
         {:ok, %{"schema" => %{"name" => name} = schema}} <- StreamInfo.metadata(info),
         {:ok, opts} <- recorded(name, schema, module, topic[:encoding] || :auto) do
      opts ++ Keyword.drop(topic, [:encoding])
    else
      _ -> typed(topic, info.type_name)
    end
  end

  defp recorded(name, %{"encoding" => "ros1msg", "definition" => text}, _module, encoding)
       when encoding in [:auto, :ros1],
       do: {:ok, [type: name, definition: text]}

  defp recorded(name, %{"encoding" => "ros2msg", "definition" => text}, Mcap.Writer, encoding)
       when encoding in [:auto, :cdr],
       do: {:ok, [type: name, definition: text, encoding: :cdr]}

  defp recorded(name, %{"encoding" => "protobuf", "definition" => set}, Mcap.Writer, encoding)
       when encoding in [:auto, :protobuf],
       do: {:ok, [type: name, definition: set, encoding: :protobuf]}

  defp recorded(_name, _schema, _module, _encoding), do: :error

  defp typed(topic, type) do
    if topic[:type] == nil and known?(type, topic[:encoding]),
      do: Keyword.put(topic, :type, Definition.plain(type)),
      else: topic
  end

  defp known?(type, :protobuf), do: Messages.known?(type)
  defp known?(_type, :json), do: false
  defp known?(type, _ros), do: Library.fetch(Definition.plain(type)) != :error

  # Returns each stream with its next messages, ordered by time: `{time, name, messages, next_ordinal, stream}`.
  defp heads(store, wanted, reading, encoding) do
    streams = Store.streams(store)
    extras = Extra.streams(streams)
    folded = for {_, %StreamInfo{name: name}} <- extras, do: name

    for info <- streams,
        wanted == nil or info.name in wanted,
        info.name not in folded,
        info.count > 0,
        stream = {whole(store, info.type_name, encoding), {info, extras[info.name]}, reading},
        reduce: [] do
      heads -> put_head([], info.name, first(store, info, reading[:from]), stream, heads)
    end
  end

  defp first(_store, _info, nil), do: 0

  defp first(store, info, from) do
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

  # Inserts after heads with the same time, so that streams alternate.
  defp insert_head([{other, _, _, _, _} = head | heads], time, new) when other <= time,
    do: [head | insert_head(heads, time, new)]

  defp insert_head(heads, _time, new), do: [new | heads]

  defp read_messages({store, {info, extra}, reading}, from) do
    to = reading[:to] || :unbounded

    case store.module.read(store.state, info, from, to, 100, reading) do
      {:ok, [], next} -> {[], next}
      {:ok, messages, next} -> {Extra.join(messages, store, extra, from), next}
      {:error, error} -> raise error
    end
  end
end
