defmodule Situ.TapTest do
  use ExUnit.Case, async: true
  import Situ.Test.Eventually

  alias Situ.{Connector, Message, Pipeline}

  setup do
    connector = Connector.new("in")

    {:ok, p} =
      Pipeline.start(
        fn p ->
          p
          |> Connector.receive(connector)
          |> Situ.map(&(&1 + 1), name: "Plus")
          |> Situ.filter(&(rem(&1, 2) == 0), name: "Even")
          |> Situ.map(&(&1 * 10), name: "Ten")
        end,
        pipeline: [stop_timeout: 300]
      )

    :ok = Connector.await_open(connector, 30_000)
    on_exit(fn -> Pipeline.stop(p) end)
    %{p: p, connector: connector}
  end

  test "taps at the source, in the middle of a chain and at the end see their own data",
       %{p: p} = c do
    me = self()

    for name <- ["in", "Plus", "Even", "Ten"],
        do: {:ok, _} = Situ.attach_tap({p, name}, &send(me, {name, &1.data}))

    post(c, [1, 2, 3])
    for m <- [{"in", 1}, {"in", 2}, {"in", 3}], do: assert_receive(^m)
    for m <- [{"Plus", 2}, {"Plus", 3}, {"Plus", 4}], do: assert_receive(^m)
    for m <- [{"Even", 2}, {"Even", 4}, {"Ten", 20}, {"Ten", 40}], do: assert_receive(^m)
    refute_received {"Even", 3}
    assert Enum.count(Pipeline.info(p).nodes, &(&1.kind == :tap)) == 4
  end

  test "after detach no more messages arrive and the graph is as before", %{p: p} = c do
    me = self()
    before = Pipeline.info(p)
    {:ok, tap} = Situ.attach_tap({p, "Even"}, &send(me, {:seen, &1.data}))
    post(c, [1])
    assert_receive {:seen, 2}
    :ok = Situ.detach_tap(tap)
    assert Enum.map(Pipeline.info(p).nodes, & &1.path) == Enum.map(before.nodes, & &1.path)
    {:ok, _} = Situ.attach_tap({p, "Ten"}, &send(me, {:end, &1.data}))
    post(c, [3], 10)
    assert_receive {:end, 40}
    refute_received {:seen, 4}
  end

  test "a stuck tap delays neither the pipeline nor its stop", %{p: p} = c do
    me = self()
    {:ok, _} = Situ.attach_tap({p, "Ten"}, fn _ -> receive do: (:never -> :ok) end)
    {:ok, _} = Situ.attach_tap({p, "Ten"}, &send(me, {:seen, &1.data}))
    post(c, [1])
    assert_receive {:seen, 20}
    post(c, Enum.to_list(3..21//2), 10)
    for n <- 3..21//2, do: assert_receive({:seen, seen} when seen == (n + 1) * 10)
  end

  test "a tap is removed when the process that attached it ends", %{p: p} do
    task = Task.async(fn -> Situ.attach_tap({p, "Ten"}, fn _ -> :ok end) end)
    {:ok, _tap} = Task.await(task)
    assert eventually(fn -> Enum.all?(Pipeline.info(p).nodes, &(&1.kind != :tap)) end)
  end

  test "an error for an unknown name suggests the nearest name", %{p: p} do
    assert {:error, %{code: :unknown_stream, fix: fix}} = Situ.attach_tap({p, "Evem"}, & &1)
    assert fix =~ "Even"
  end

  defp post(%{connector: connector}, values, from \\ 0) do
    messages =
      for {v, i} <- Enum.with_index(values), do: %Message{data: v, originating_time: from + i}

    Connector.deliver_messages(connector, messages)
  end
end
