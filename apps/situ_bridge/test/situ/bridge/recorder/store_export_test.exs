defmodule Situ.Bridge.Recorder.StoreExportTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.Recorder
  alias Situ.Store
  alias Situ.Store.Writer

  @moduletag :tmp_dir

  # A format that keeps the messages in the order in which they are written.
  defmodule Listed do
    @behaviour Recorder
    defstruct count: 0, pid: nil
    @impl true
    def file_options, do: []
    @impl true
    def topic_options, do: []
    @impl true
    def create(_path, _opts), do: {:ok, %__MODULE__{pid: self()}}

    @impl true
    def write(state, topic, message, _opts) do
      send(state.pid, {:written, message.originating_time, topic, message.data})
      {:ok, %{state | count: state.count + 1}}
    end

    @impl true
    def flush(state), do: {:ok, state}
    @impl true
    def finish(state), do: {:ok, state}
  end

  test "writes messages by time, and alternates streams of the same rate", %{tmp_dir: root} do
    {:ok, writer} = Writer.create("merged", root)
    # There are more messages than one read returns, at equal and at different rates.
    periods = [{"a", 2}, {"b", 2}, {"c", 3}, {"late", 7}]

    wanted =
      for {name, period} <- periods, i <- 1..div(5_000, period) do
        time = if name == "late", do: 2_000 + i * period, else: i * period
        {time, name, i}
      end

    for {name, _} <- periods do
      {:ok, stream} = Writer.stream(writer, name, type: :integer)

      messages =
        for {time, ^name, i} <- wanted,
            do: %Situ.Message{
              data: i,
              originating_time: time,
              creation_time: time,
              sequence_id: i
            }

      {:ok, _} = Writer.append(stream, messages)
    end

    :ok = Writer.close(writer)
    store = Store.open!(writer.path)
    n = length(wanted)
    assert {:ok, ^n} = Recorder.StoreExport.export_store(Listed, store, "unused", [])
    written = written()
    assert Enum.map(written, &elem(&1, 0)) == wanted |> Enum.map(&elem(&1, 0)) |> Enum.sort()
    assert Enum.sort(written) == Enum.sort(wanted)
    # Streams of the same rate alternate.
    assert for({_, name, _} <- written, name in ["a", "b"], do: name) ==
             List.flatten(List.duplicate(["a", "b"], 2_500))
  end

  defp written do
    receive do
      {:written, time, topic, data} -> [{time, topic, data} | written()]
    after
      0 -> []
    end
  end
end
