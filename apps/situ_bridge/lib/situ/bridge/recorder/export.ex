defmodule Situ.Bridge.Recorder.Export do
  @moduledoc false
  # A recording as a file of another format: all its streams' messages, merged by time.
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
    messages = merged(store, wanted, reading, topic[:encoding])
    topics = Map.new(streams, &{&1.name, typed(topic, &1, module)})
    topic = &Map.fetch!(topics, &1)

    job = %{
      module: module,
      path: path,
      opts: opts,
      topic: topic,
      infos: infos,
      progress: progress
    }

    written(job, messages, MapSet.new())
  end

  # A stream's first message settles how it is written where the caller does not. One that a later message does not fit
  # is written as JSON: from the beginning, since a topic is written in one way.
  defp written(job, messages, json) do
    with {:ok, writer} <- job.module.create(job.path, job.opts) do
      case copy(messages, writer, job, json) do
        {:ok, writer} ->
          with {:ok, _} <- job.module.finish(writer), do: {:ok, writer.count}

        {:error, name, %{code: :not_writable} = error} ->
          if free?(job, name) and not MapSet.member?(json, name),
            do: written(job, messages, MapSet.put(json, name)),
            else: {:error, error}

        {:error, _name, error} ->
          {:error, error}
      end
    end
  end

  defp free?(job, name) do
    topic = job.topic.(name)

    Keyword.has_key?(job.module.topic_options(), :encoding) and topic[:type] == nil and
      topic[:encoding] in [nil, :auto]
  end

  defp copy(messages, writer, job, json) do
    Enum.reduce_while(messages, {:ok, writer}, fn {name, message}, {:ok, writer} ->
      json? = MapSet.member?(json, name)
      topic = if json?, do: [encoding: :json], else: job.topic.(name)

      with :ok <- there(message.data, job, name, json?),
           {:ok, writer} <- job.module.write(writer, name, message, topic) do
        if rem(writer.count, 1_000) == 0, do: job.progress.(writer.count)
        {:cont, {:ok, writer}}
      else
        {:error, error} -> {:halt, {:error, name, error}}
      end
    end)
  rescue
    error in Error -> {:error, nil, error}
  end

  # ROS has no missing number or text: it would become 0 or "".
  defp there(nil, job, name, false) do
    if free?(job, name) and not struct?(job.infos[name].type),
      do: {:error, Error.new(:not_writable, "a message of #{name} is nil")},
      else: :ok
  end

  defp there(_data, _job, _name, _json?), do: :ok

  defp struct?({:optional, type}), do: struct?(type)
  defp struct?(type), do: is_atom(type) and match?("Elixir." <> _, Atom.to_string(type))

  # A message that came from ROS or Foxglove, and goes as the type that it was, goes with all that was in it.
  defp whole(%{module: module, state: state} = store, type, encoding) do
    if known?(type, encoding) and function_exported?(module, :as_maps, 1),
      do: %{store | state: module.as_maps(state)},
      else: store
  end

  # An imported stream knows the type that it had.
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

  # Holds each stream's next message; the earliest goes first.
  defp merged(store, wanted, reading, encoding) do
    streams = Store.streams(store)
    extras = Extra.streams(streams)
    folded = for {_, %StreamInfo{name: name}} <- extras, do: name

    heads =
      for info <- streams,
          wanted == nil or info.name in wanted,
          info.name not in folded,
          info.count > 0,
          from = {whole(store, info.type_name, encoding), {info, extras[info.name]}, reading},
          head = head(from, first(store, info, reading[:from])),
          do: head

    Stream.unfold(heads, fn
      [] ->
        nil

      heads ->
        {[message | rest], _, {_, {info, _}, _}} =
          first = Enum.min_by(heads, fn {[m | _], _, _} -> m.originating_time end)

        {{info.name, message}, advance(heads, first, rest)}
    end)
  end

  defp first(_store, _info, nil), do: 0

  defp first(store, info, from) do
    case Store.ordinal(store, info, from) do
      {:ok, ordinal} -> ordinal
      {:error, error} -> raise error
    end
  end

  defp advance(heads, {_, next, stream} = first, []),
    do: List.delete(heads, first) ++ List.wrap(head(stream, next))

  defp advance(heads, {_, next, stream} = first, rest),
    do: [{rest, next, stream} | List.delete(heads, first)]

  defp head({store, {info, extra}, reading} = stream, from) do
    to = reading[:to] || :unbounded

    case store.module.read(store.state, info, from, to, 100, reading) do
      {:ok, [], _} -> nil
      {:ok, messages, next} -> {Extra.join(messages, store, extra, from), next, stream}
      {:error, error} -> raise error
    end
  end
end
