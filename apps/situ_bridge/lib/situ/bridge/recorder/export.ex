defmodule Situ.Bridge.Recorder.Export do
  @moduledoc false
  # A recording as a file of another format: all its streams' messages, merged by time.
  alias Situ.Bridge.Ros.Library
  alias Situ.Store

  def export(module, store, path, opts) do
    {wanted, opts} = Keyword.pop(opts, :streams)
    {topic, opts} = Keyword.split(opts, Keyword.keys(module.topic_options()))
    types = Map.new(Store.streams(store), &{&1.name, &1.type_name})

    with {:ok, writer} <- module.create(path, opts),
         {:ok, writer} <- copy(merged(store, wanted), {module, writer}, topic, types),
         {:ok, _} <- module.finish(writer),
         do: {:ok, writer.count}
  end

  defp copy(messages, {module, writer}, topic, types) do
    Enum.reduce_while(messages, {:ok, writer}, fn {name, message}, {:ok, writer} ->
      case module.write(writer, name, message, typed(topic, types[name])) do
        {:ok, writer} -> {:cont, {:ok, writer}}
        error -> {:halt, error}
      end
    end)
  rescue
    error in Situ.Error -> {:error, error}
  end

  # What came from ROS goes as what it was.
  defp typed(topic, type) do
    if topic[:type] == nil and Library.fetch(type) != :error,
      do: Keyword.put(topic, :type, type),
      else: topic
  end

  # Each stream's next message is kept at hand; the earliest goes first.
  defp merged(store, wanted) do
    heads =
      for info <- Store.streams(store),
          wanted == nil or info.name in wanted,
          info.count > 0,
          head = head(store, info, 0),
          do: head

    Stream.unfold(heads, fn
      [] ->
        nil

      heads ->
        {[message | rest], _, info} =
          first = Enum.min_by(heads, fn {[m | _], _, _} -> m.originating_time end)

        {{info.name, message}, advance(heads, first, rest, store)}
    end)
  end

  defp advance(heads, {_, next, info} = first, [], store),
    do: List.delete(heads, first) ++ List.wrap(head(store, info, next))

  defp advance(heads, {_, next, info} = first, rest, _store),
    do: [{rest, next, info} | List.delete(heads, first)]

  defp head(store, info, from) do
    case store.module.read(store.state, info, from, :unbounded, 100, []) do
      {:ok, [], _} -> nil
      {:ok, messages, next} -> {messages, next, info}
      {:error, error} -> raise error
    end
  end
end
