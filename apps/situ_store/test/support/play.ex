defmodule Situ.Store.Test.Play do
  @moduledoc false
  # Records and replays stores with pipelines, and collects the messages.
  import ExUnit.Assertions
  alias Situ.{Pipeline, Store}

  def record(root, name, values, opts \\ []) do
    items = for {v, i} <- Enum.with_index(values), do: {i * 1_000_000, v}

    {:ok, report} =
      Pipeline.run(fn p ->
        exporter = Store.create(p, name, root, opts)
        p |> Situ.from_enumerable(items) |> Store.write(exporter, "seq", type: :integer)
        exporter.path
      end)

    report.result
  end

  def replay(path, name, settings \\ [], opts \\ []) do
    test = self()

    {:ok, report} =
      Pipeline.run(
        fn p -> p |> Store.importer(path, opts) |> Store.stream(name) |> collect(test) end,
        pipeline: settings
      )

    received(report.result)
  end

  # Sends every message to the test and returns the tag of these messages.
  def collect(stream, test) do
    tag = make_ref()
    Situ.each(stream, fn _data, message -> send(test, {tag, message}) end)
    tag
  end

  def received(tag, got \\ []) do
    receive do
      {^tag, message} -> received(tag, [message | got])
    after
      0 -> Enum.reverse(got)
    end
  end

  @doc "Receives messages up to and including `data` and returns them, the latest first."
  def played(data, got) do
    assert_receive {:got, now, m}
    got = [{now, m.originating_time} | got]
    if now == data, do: got, else: played(data, got)
  end
end
