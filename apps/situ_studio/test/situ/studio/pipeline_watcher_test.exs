defmodule Situ.Studio.PipelineWatcherTest do
  use ExUnit.Case, async: true
  import Situ.Test.Eventually

  alias Situ.Studio.{PipelineWatcher, StreamOverview, StreamReader, Recordings}

  setup do
    connector = Situ.Connector.new("in")

    {:ok, pipeline} =
      Situ.Pipeline.start(
        fn p ->
          p
          |> Situ.Connector.receive(connector)
          |> Situ.map(&(&1 * 2.0), name: "Doubled", type: :float)
        end,
        pipeline: [name: "Test"]
      )

    supervisor = start_supervised!(DynamicSupervisor)
    %{pipeline: pipeline, connector: connector, supervisor: supervisor}
  end

  defp feed(connector, times) do
    Situ.Connector.deliver_messages(
      connector,
      for(t <- times, do: %Situ.Message{data: t, originating_time: t})
    )
  end

  test "lists named streams, taps a requested one, and keeps its messages", context do
    assert [{"Test", _}] = Recordings.Pipeline.list_running([context.pipeline])
    {:ok, source} = Recordings.Pipeline.open([context.pipeline], "Test", context.supervisor)
    %{state: watch} = source
    {:ok, streams} = StreamOverview.list_streams(source)
    assert %{shape: :signal} = Enum.find(streams, &(&1.name == "Doubled"))
    assert taps(context.pipeline) == []
    {:ok, %{from: from}} = StreamReader.fetch_extent(source)
    assert abs(from - Situ.Pipeline.now(context.pipeline)) < 5_000_000_000

    assert :none = StreamReader.latest_at(source, "Doubled", 100)
    assert ["Studio: Doubled"] = taps(context.pipeline)

    feed(context.connector, 1..10)
    assert eventually(fn -> match?({:ok, %{data: 20.0}}, latest(source, 100)) end)
    assert {:ok, %{data: 8.0}} = latest(source, 4)
    assert {:ok, %{live: true, to: 10}} = StreamReader.fetch_extent(source)

    {:ok, _} = Situ.Pipeline.stop(context.pipeline)
    send(watch.pid, :sweep)
    :ets.delete(watch.uses, :streams)
    assert {:ok, %{live: false, to: 10}} = StreamReader.fetch_extent(source)
    assert {:ok, %{data: 20.0}} = latest(source, 100)
    assert [] = Recordings.Pipeline.list_running([context.pipeline])
  end

  test "releases a stream that was not requested for a while", context do
    {:ok, source} = Recordings.Pipeline.open([context.pipeline], "Test", context.supervisor)
    %{state: watch} = source
    :none = StreamReader.latest_at(source, "Doubled", 100)
    long_ago = System.monotonic_time(:millisecond) - 60_000
    :ets.update_element(watch.uses, "Doubled", {2, long_ago})
    send(watch.pid, :sweep)
    # The call returns after the sweep.
    %PipelineWatcher{} = PipelineWatcher.reader_handle(watch.pid)
    assert taps(context.pipeline) == []
    :none = StreamReader.latest_at(source, "Doubled", 100)
    assert ["Studio: Doubled"] = taps(context.pipeline)
    {:ok, _} = Situ.Pipeline.stop(context.pipeline)
  end

  test "keeps the history of a pipeline that is missing for a moment", context do
    there = :counters.new(1, [])

    find = fn ->
      case :counters.get(there, 1) do
        0 -> context.pipeline
        1 -> nil
        2 -> exit(:noproc)
      end
    end

    {:ok, source} = Recordings.Pipeline.open([{"Part", find}], "Part", context.supervisor)
    %{state: watch} = source
    :none = latest(source, 100)
    feed(context.connector, 1..10)
    assert eventually(fn -> match?({:ok, %{data: 20.0}}, latest(source, 100)) end)
    :counters.add(there, 1, 1)
    {:ok, _} = Situ.Pipeline.stop(context.pipeline)
    # It has processed the end of the pipeline.
    %PipelineWatcher{} = PipelineWatcher.reader_handle(watch.pid)

    for _ <- 1..2 do
      :ets.delete(watch.uses, :streams)
      assert {:ok, %{live: true, to: 10}} = StreamReader.fetch_extent(source)
      assert {:ok, %{data: 20.0}} = latest(source, 100)
      assert {:ok, [_ | _], _} = StreamOverview.read_series(source, "Doubled", 0, 10, 1)
      :counters.add(there, 1, 1)
    end
  end

  test "keeps a stream that a page shows, although no window is requested",
       context do
    {:ok, source} = Recordings.Pipeline.open([context.pipeline], "Test", context.supervisor)
    %{state: watch} = source
    open = %{"open" => [[1, %{"stream" => "Doubled", "viz" => "line"}]]}
    {_, session} = Situ.Studio.Asking.ask(Situ.Studio.DataSession.new(source), open)
    assert ["Studio: Doubled"] = taps(context.pipeline)
    long_ago = System.monotonic_time(:millisecond) - 60_000
    :ets.update_element(watch.uses, "Doubled", {2, long_ago})
    {_, session} = Situ.Studio.Asking.ask(session, %{"live" => true})
    send(watch.pid, :sweep)
    %PipelineWatcher{} = PipelineWatcher.reader_handle(watch.pid)
    assert ["Studio: Doubled"] = taps(context.pipeline)
    # The same holds for the streams of a derived one.
    derived = %{session | source: Recordings.DerivedStreams.wrap(source), channels: %{}}
    :ets.update_element(watch.uses, "Doubled", {2, long_ago})
    open = %{"open" => [[1, %{"stream" => "= Doubled + 1", "viz" => "line"}]]}
    Situ.Studio.Asking.ask(derived, open)
    send(watch.pid, :sweep)
    %PipelineWatcher{} = PipelineWatcher.reader_handle(watch.pid)
    assert ["Studio: Doubled"] = taps(context.pipeline)
    {:ok, _} = Situ.Pipeline.stop(context.pipeline)
  end

  defmodule Restarted do
    use Situ.Pipeline

    @impl true
    def build(p, opts) do
      p
      |> Situ.Connector.receive(opts[:connector])
      |> Situ.map(&(&1 * 2.0), name: "Doubled", type: :float)
    end
  end

  @tag :capture_log
  test "a page shows a pipeline again after its supervisor restarted it", context do
    children = [{Restarted, connector: context.connector}]

    {:ok, keeper} =
      start_supervised(%{
        id: :keeper,
        start: {Supervisor, :start_link, [children, [strategy: :one_for_one]]}
      })

    find = fn -> with [{_, pid, _, _}] <- Supervisor.which_children(keeper), do: pid end

    {:ok, source} = Recordings.Pipeline.open([{"again", find}], "again", context.supervisor)
    %{state: watch} = source
    session = Situ.Studio.DataSession.new(source)

    # The page sends this request for each frame: the window at the end of a line.
    ask = fn session, from ->
      request =
        ~s({"req":1,"open":[[1,{"stream":"Doubled","viz":"line"}]],"series":[[1,"#{from}","#{from + 50}",1]]})

      {:ok, reply, session} = Situ.Studio.DataSession.handle_request(request, session)

      <<_::binary-24, 1::little-32, _::binary-12, kind::little-16, _::binary-10, rows::little-32,
        _::binary>> = IO.iodata_to_binary(reply)

      {if(kind == 1, do: rows), session}
    end

    {_, session} = ask.(session, 0)
    before = find.()
    feed(context.connector, 1..10)
    assert eventually(fn -> match?({10, _}, ask.(session, 0)) end)

    ref = Process.monitor(before)
    Process.exit(before, :kill)
    assert_receive {:DOWN, ^ref, _, _, _}

    assert eventually(fn ->
             is_pid(find.()) and find.() != before and
               match?([{"again", _}], Recordings.Pipeline.list_running([{"again", find}]))
           end)

    # The next sweep releases the old tap, and the next request taps the new pipeline.
    send(watch.pid, :sweep)
    %PipelineWatcher{} = PipelineWatcher.reader_handle(watch.pid)
    {_, session} = ask.(session, 0)
    assert ["Studio: Doubled"] = taps(find.())
    feed(context.connector, 101..110)

    # The ten earlier messages are included, and the gap between them.
    assert eventually(fn -> match?({21, _}, ask.(session, 101)) end)
    assert {:ok, %{live: true, from: 1, to: 110}} = StreamReader.fetch_extent(source)
    {:ok, _} = Situ.Pipeline.stop(context.pipeline)
  end

  test "returns specific errors for an unknown stream and a stopped pipeline", context do
    {:ok, source} = Recordings.Pipeline.open([context.pipeline], "Test", context.supervisor)
    assert {:error, %Situ.Error{}} = StreamReader.latest_at(source, "Nothing", 1)

    assert {:error, %{code: :not_running}} =
             Recordings.Pipeline.open([], "Test", context.supervisor)

    {:ok, _} = Situ.Pipeline.stop(context.pipeline)
  end

  defp latest(source, time), do: StreamReader.latest_at(source, "Doubled", time)

  defp taps(pipeline) do
    for %{kind: :tap, path: path, state: :running} <- Situ.Pipeline.info(pipeline).nodes, do: path
  end
end
