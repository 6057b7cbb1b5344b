defmodule Situ.Ports.SubscriberTest do
  # What a subscriber sends again when its consumer is replaced.
  use ExUnit.Case, async: true

  alias Situ.{Delivery, Message}
  alias Situ.Ports.{Counters, Subscriber}

  defp message(time),
    do: %Message{
      data: time,
      originating_time: time,
      creation_time: time,
      sequence_id: time,
      source_id: 1
    }

  defp subscriber(pid) do
    sub = Subscriber.new(1, pid, Counters.new(), Delivery.unlimited())
    sub = Subscriber.add_demand(sub, 10)
    Subscriber.deliver_batches(sub, [[message(1), message(2)]], 2, {2, 0}, 2)
  end

  defp flush(entries) do
    receive do
      {:"$gen_consumer", {_pid, 1}, entry} -> flush([entry | entries])
    after
      0 -> Enum.reverse(entries)
    end
  end

  test "the process that replaces a consumer receives the unhandled messages again" do
    dead = spawn(fn -> :ok end)
    sub = dead |> subscriber() |> Subscriber.replace_consumer(self())
    assert flush([]) == []
    Subscriber.add_demand(sub, 10)
    assert [[[%{data: 1}, %{data: 2}]]] = flush([])
  end

  test "a consumer that is announced twice receives nothing twice" do
    sub = subscriber(self())
    assert [_entry] = flush([])
    sub = sub |> Subscriber.replace_consumer(self()) |> Subscriber.add_demand(10)
    assert flush([]) == []
    assert sub.demand == 18
  end

  test "after the closing mark, a new process receives the messages and the mark again" do
    dead = spawn(fn -> :ok end)
    assert [sub] = Subscriber.close_drained(subscriber(dead), 5)
    assert Subscriber.closed?(sub)
    sub = Subscriber.replace_consumer(sub, self())
    assert Subscriber.closed?(sub)
    assert [[[%{data: 1}, _]], {:cancel, {:shutdown, {:closed, 5}}}] = flush([])
  end

  test "after the closing mark, a consumer that is announced twice receives the mark again" do
    assert [sub] = Subscriber.close_drained(subscriber(self()), 5)
    assert [_entry, {:cancel, _}] = flush([])
    assert sub == Subscriber.replace_consumer(sub, self())
    assert [{:cancel, {:shutdown, {:closed, 5}}}] = flush([])
  end
end
