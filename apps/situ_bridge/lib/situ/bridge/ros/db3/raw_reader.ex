defmodule Situ.Bridge.Ros.Db3.RawReader do
  @moduledoc false
  # Reads the messages of a ROS 2 bag in SQLite without decoding them.
  @behaviour Situ.Bridge.Raw.Reader
  alias Situ.Bridge.RawChannel
  alias Situ.Bridge.Ros.Db3.{Sqlite, Topics}
  alias Situ.Bridge.Ros.MessageIndex

  # Maximum size of the messages in one batch, in bytes.
  @max_batch 4 * 1024 * 1024

  @impl true
  def list_channels(state) do
    with {:ok, topics} <- Topics.read_topics(state.path),
         {:ok, definitions} <- Topics.read_definitions(state.path),
         {:ok, rows} <-
           Sqlite.query(state.path, "select topic_id, timestamp, id, length(data) from messages") do
      places = group_places(rows)
      {:ok, for(topic <- topics, do: build_channel(topic, definitions, places))}
    end
  end

  defp group_places(rows) do
    rows
    |> Enum.flat_map(&Topics.parse_numbers/1)
    |> Enum.group_by(&hd/1, fn [_topic, time, id, size] -> {time, id, size} end)
  end

  defp build_channel(topic, definitions, places) do
    rows = Map.get(places, topic.id, [])

    %RawChannel{
      id: topic.id,
      topic: topic.name,
      stream: topic.name,
      encoding: topic.format,
      schema: build_schema(topic.type, definitions),
      metadata: topic.metadata,
      count: length(rows),
      places: MessageIndex.pack(rows)
    }
  end

  # Files from before Iron contain no definitions.
  defp build_schema(type, definitions) do
    case definitions do
      %{^type => {language, text}} -> {type, language, text}
      _ -> {type, "ros2msg", Topics.standard_definition(type) || ""}
    end
  end

  @impl true
  def seek(_state, channel, time), do: {:ok, MessageIndex.seek(channel.places, time)}

  @impl true
  def read(state, channel, ordinal, limit) do
    case channel.places |> MessageIndex.slice(ordinal, :unbounded, limit) |> take_batch(0) do
      [] -> {:ok, [], ordinal}
      places -> read_places(state.path, places, ordinal)
    end
  end

  defp take_batch([{_, _, size} = row | rows], bytes) when bytes < @max_batch,
    do: [row | take_batch(rows, bytes + size)]

  defp take_batch(_rows, _bytes), do: []

  defp read_places(path, places, ordinal) do
    ids = Enum.map_join(places, ",", &elem(&1, 1))
    sql = "select id, timestamp, hex(data) from messages where id in (#{ids})"

    with {:ok, rows} <- Sqlite.query(path, sql) do
      by_id =
        for [id, time, hex] <- rows, [id, time] <- Topics.parse_numbers([id, time]), into: %{} do
          {id, {time, time, 0, Base.decode16!(hex)}}
        end

      # Another program may have deleted messages since the file was opened.
      {:ok, for({_, id, _} <- places, row = by_id[id], do: row), ordinal + length(places)}
    end
  end

  @impl true
  def read_extras(_state), do: {:ok, [], []}
end
