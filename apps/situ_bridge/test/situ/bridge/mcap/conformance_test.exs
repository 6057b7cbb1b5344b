defmodule Situ.Bridge.Mcap.ConformanceTest do
  # The inputs of MCAP's conformance suite (https://github.com/foxglove/mcap, tests/conformance) in every combination of
  # features that this test's builder makes, in both directions and by value. Nothing is refused. The suite's own 416
  # files are equal in the same way.
  use ExUnit.Case, async: true
  alias Situ.Bridge.{Mcap, McapRecords, RawMessages}
  alias Situ.Store

  @moduletag :tmp_dir

  @nothing %{
    profile: "",
    library: "",
    compression: :none,
    schemas: [],
    channels: [],
    messages: [],
    attachments: [],
    metadata: [],
    private: []
  }
  @example %{
    schemas: [{1, "Example", "c", <<4, 5, 6>>}],
    channels: [{1, 1, "example", "a", %{"foo" => "bar"}}]
  }

  defp inputs do
    one = %{channel: 1, sequence: 10, log: 2, publish: 1, data: <<1, 2, 3>>}

    ten =
      for {time, n} <- Enum.with_index([0, 2, 1, 3, 3, 5, 4, 7, 8, 9]),
          do: %{one | sequence: n, log: time, publish: time}

    attachment = %{
      log: 2,
      created: 1,
      name: "myFile",
      type: "application/octet-stream",
      data: <<1, 2, 3>>
    }

    [
      no_data: %{},
      one_schemaless_message: %{channels: [{1, 0, "example", "text", %{}}], messages: [one]},
      one_message: Map.put(@example, :messages, [one]),
      one_attachment: %{attachments: [attachment]},
      one_metadata: %{metadata: [{"myMetadata", %{"foo" => "bar"}}]},
      ten_messages: Map.put(@example, :messages, ten)
    ]
  end

  test "reads and writes the inputs of the suite by value", %{tmp_dir: dir} do
    [path, empty, copy, merged] =
      for name <- ~w(in empty copy merged), do: Path.join(dir, "#{name}.mcap")

    File.write!(empty, McapRecords.build(@nothing, []))

    for {name, input} <- inputs(), features <- McapRecords.variants() do
      file = Map.merge(@nothing, input)
      File.write!(path, McapRecords.build(file, features))
      assert {name, features, read_values(path)} == {name, features, values(file)}

      # Copied record by record, and merged with a file that has nothing.
      assert {:ok, _} = RawMessages.copy([path], copy)
      assert {:ok, _} = RawMessages.copy([path, empty], merged)

      for out <- [copy, merged] do
        written = out |> File.read!() |> McapRecords.read()
        assert {name, features, values(written)} == {name, features, values(file)}
        assert written.attachments == file.attachments
      end
    end
  end

  # What Situ reads: in order of time, as the index of a file is.
  defp read_values(path) do
    store = Store.open!(path)
    {:ok, channels} = RawMessages.channels(store)
    assert Store.info(store).damage == []

    %{
      messages:
        for m <- RawMessages.stream(store) do
          {m.channel.topic, m.channel.encoding, m.channel.schema, m.log_time, m.publish_time,
           m.sequence, m.bytes}
        end,
      topics: for(c <- channels, do: {c.topic, c.encoding, c.schema, Map.new(c.metadata)}),
      attachments:
        for a <- Mcap.list_attachments(store) do
          {:ok, data} = Mcap.read_attachment(store, a.name)
          {a.name, a.media_type, a.time, data}
        end,
      metadata: Store.info(store).metadata
    }
  end

  defp values(file) do
    schemas =
      Map.new(file.schemas, fn {id, name, language, data} -> {id, {name, language, data}} end)

    channels =
      Map.new(file.channels, fn {id, schema, topic, encoding, _} ->
        {id, {topic, encoding, schemas[schema]}}
      end)

    %{
      messages:
        for m <- Enum.sort_by(file.messages, & &1.log) do
          {topic, encoding, schema} = Map.fetch!(channels, m.channel)
          {topic, encoding, schema, m.log, m.publish, m.sequence, m.data}
        end,
      topics:
        for(
          {_, schema, topic, encoding, pairs} <- file.channels,
          do: {topic, encoding, schemas[schema], pairs}
        ),
      attachments: for(a <- file.attachments, do: {a.name, a.type, a.log, a.data}),
      metadata: file.metadata
    }
  end
end
