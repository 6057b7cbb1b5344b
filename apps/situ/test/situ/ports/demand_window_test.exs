defmodule Situ.Ports.DemandWindowTest do
  use ExUnit.Case, async: true
  alias Situ.Ports.DemandWindow

  @moduletag :capture_log

  test "a throttle limits nothing while both stages share a process, and applies as soon as one leaves" do
    window = DemandWindow.new_local(Situ.Delivery.throttle(2))
    assert window.size == DemandWindow.new(Situ.Delivery.unlimited()).size
    message = %Situ.Message{data: <<0>>, originating_time: 1}
    window = DemandWindow.weigh_batch(%{window | owed: 4}, [message])
    assert window.size == 1_000

    # It owes nothing until its producer has sent as much as was requested above the limit.
    limited = DemandWindow.apply_limit(window)
    assert {limited.size, limited.owed} == {3, window.owed - 997}

    assert DemandWindow.apply_limit(DemandWindow.new_local(Situ.Delivery.unlimited())).limit ==
             nil
  end

  # Emits messages of `bytes` bytes forever and counts them.
  defmodule Source do
    use Situ.Component,
      outputs: [out: :any],
      options: [bytes: [type: :pos_integer], test: [type: :pid]]

    @impl true
    def init(opts), do: {:ok, {opts[:bytes], opts[:test], 0}}

    @impl true
    def handle_demand(_n, _context, {bytes, test, n}) do
      send(test, {:made, self(), n + 1})
      {[{:out, n, {:wrapped, :binary.copy(<<0>>, bytes)}}], {bytes, test, n + 1}}
    end
  end

  # The consumer takes a few messages and then blocks; the messages emitted beyond these were in flight.
  defp made_for_a_stuck_consumer(bytes, take, policy \\ Situ.Delivery.unlimited()) do
    test = self()

    {:ok, pipeline} =
      Situ.Pipeline.start(
        fn p ->
          p
          |> Situ.source(Source, bytes: bytes, test: test)
          |> Situ.each(
            fn _, message ->
              if message.originating_time == take do
                send(test, {:stuck, self()})
                receive do: (:go_on -> :ok)
              end
            end,
            policy: policy,
            async: true
          )
        end,
        pipeline: [replay: [speed: :max]]
      )

    assert_receive {:stuck, consumer}, 30_000
    assert_receive {:made, source, 1}, 30_000
    at_rest(source, nil)
    made = last_made(0)
    Process.exit(consumer, :kill)
    Situ.Pipeline.stop(pipeline)
    made - take
  end

  # Waits until the source is idle: an empty mailbox and no work since the last check.
  defp at_rest(pid, before) do
    case Process.info(pid, [:status, :message_queue_len, :reductions]) do
      [status: :waiting, message_queue_len: 0, reductions: ^before] -> :ok
      [_, _, {:reductions, now}] -> at_rest(pid, now)
    end
  end

  defp last_made(last) do
    receive do
      {:made, _, n} -> last_made(n)
    after
      0 -> last
    end
  end

  test "the default window holds a thousand small messages, but not a thousand images" do
    # Fewer messages are in flight if the consumer has just taken many without requesting more.
    on_their_way = for _ <- 1..5, do: made_for_a_stuck_consumer(10, 5_000)
    assert Enum.max(on_their_way) in 500..1_001
    # The window is 32 MB, and each message has 4 MB.
    assert made_for_a_stuck_consumer(4_000_000, 20) in 4..9
    # This is the smallest window.
    assert made_for_a_stuck_consumer(40_000_000, 8) in 2..5
  end

  test "a throttle of n lets n messages wait in addition to the one being handled" do
    for n <- [1, 2, 5], take <- [0, 3] do
      assert made_for_a_stuck_consumer(10, take, Situ.Delivery.throttle(n)) == n + 1
    end

    # A long window is requested again in halves.
    assert made_for_a_stuck_consumer(10, 200, Situ.Delivery.throttle(128)) in 64..129
  end
end
