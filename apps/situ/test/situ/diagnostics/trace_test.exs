defmodule Situ.Diagnostics.TraceTest do
  # Traces the message of one time through a pipeline that is blocked in the middle.
  use ExUnit.Case, async: true

  alias Situ.{Clock, Connector, Message, Pipeline, Time}

  defp start(clock) do
    me = self()
    connector = Connector.new("traced #{System.unique_integer()}")

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Connector.receive(connector, name: "Door")
          |> Situ.map(& &1, name: "First", async: true)
          |> Situ.map(
            fn v ->
              send(me, {:at, self(), v})
              receive do: (:go -> v)
            end,
            name: "Slow",
            async: true
          )
          |> Situ.each(&send(me, {:out, &1}), name: "Sink", async: true)
        end,
        pipeline: [clock: clock, replay: [interval: {0, :unbounded}]]
      )

    :ok = Connector.await_open(connector, :infinity)
    {p, connector}
  end

  # Polls for the wanted states, since counters are published shortly after a message was sent.
  defp trace(p, time, wanted, tries \\ 3_000) do
    trace = Situ.trace(p, time)
    states = for hop <- trace.hops, do: hop.state

    cond do
      states == wanted -> trace
      tries == 0 -> flunk("never #{inspect(wanted)}: #{inspect(trace)}")
      true -> Process.sleep(10) && trace(p, time, wanted, tries - 1)
    end
  end

  test "a message is coming, waiting and then passed, with its waiting time" do
    clock = Clock.manual(0)
    {p, connector} = start(clock)
    t = Time.ms(1)
    assert [:coming, :coming, :coming] = for(hop <- Situ.trace(p, t).hops, do: hop.state)

    Clock.set(clock, Time.ms(2))
    :ok = Connector.deliver_messages(connector, [%Message{data: 1, originating_time: t}])
    assert_receive {:at, slow, 1}, 30_000
    trace = trace(p, t, [:passed, :waiting, :coming])
    assert [%{from: "Door", to: "First"}, %{from: "First", to: "Slow", queue: 1}, _] = trace.hops
    assert trace.inside == []
    assert Situ.Diagnostics.format(trace) =~ "waits for Slow"

    # Later messages wait in the queue after it.
    Clock.set(clock, Time.ms(5))
    :ok = Connector.deliver_messages(connector, [%Message{data: 2, originating_time: Time.ms(4)}])
    second = trace(p, Time.ms(4), [:passed, :waiting, :coming])
    assert Enum.at(second.hops, 1).queue == 2
    Clock.set(clock, Time.ms(105))
    assert Enum.at(Situ.trace(p, Time.ms(4)).hops, 1).waited == Time.ms(100)

    send(slow, :go)
    assert_receive {:out, 1}, 30_000
    assert_receive {:at, ^slow, 2}, 30_000
    done = trace(p, t, [:passed, :passed, :passed])
    assert done.inside == ["Sink"]
    send(slow, :go)
    assert_receive {:out, 2}, 30_000
    late = trace(p, Time.ms(4), [:passed, :passed, :passed])
    assert Enum.at(late.hops, 1).waited == Time.ms(100)

    assert Situ.Diagnostics.format(late) =~
             "First -> Slow: passed sent 1.00 ms after its time waited 100 ms"

    assert {:ok, _} = Pipeline.stop(p)
  end

  test "tracing an ended pipeline raises an error and does not crash" do
    {p, _} = start(Clock.manual(0))
    assert {:ok, _} = Pipeline.stop(p)
    assert_raise Situ.Error, fn -> Situ.trace(p, 0) end
  end
end
