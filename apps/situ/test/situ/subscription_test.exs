defmodule Situ.SubscriptionTest do
  use ExUnit.Case, async: true
  import Situ.Test.Eventually
  alias Situ.{Connector, Error, Message, Pipeline, Subscription}

  doctest Subscription

  defp start_pipeline(name \\ nil) do
    connector = Connector.new("in")

    {:ok, p} =
      Pipeline.start(
        fn p -> p |> Connector.receive(connector) |> Situ.map(& &1, name: "Numbers") end,
        pipeline: if(name, do: [name: name], else: [])
      )

    :ok = Connector.await_open(connector, 30_000)
    on_exit(fn -> Pipeline.stop(p) end)
    %{p: p, connector: connector}
  end

  defp post(c, numbers) do
    me = self()
    {:ok, tap} = Situ.attach_tap({c.p, "Numbers"}, &send(me, {:passed, &1.data}))
    messages = for n <- numbers, do: %Message{data: n, originating_time: n}
    Connector.deliver_messages(c.connector, messages)
    for n <- numbers, do: assert_receive({:passed, ^n})
    Situ.detach_tap(tap)
  end

  # The subscription has received the last message when it has answered a later request.
  defp settle(subscription), do: :sys.get_state(subscription)

  test "a busy process gets the latest message, one at a time" do
    c = start_pipeline()
    {:ok, subscription} = Subscription.start_link({c.p, "Numbers"}, every: 0, tag: :numbers)
    settle(subscription)
    post(c, [1, 2, 3])
    assert_receive {:situ, :numbers, %Message{data: 1}}
    assert eventually(fn -> match?(%{latest: %{data: 3}}, settle(subscription)) end)
    refute_received {:situ, _, _}
    :ok = Subscription.request_next(subscription)
    assert_receive {:situ, :numbers, %Message{data: 3}}
    {:ok, _} = Pipeline.stop(c.p)
    assert_receive {:situ, :numbers, :ended}
  end

  test "two messages are at least `every:` milliseconds apart" do
    c = start_pipeline()
    {:ok, subscription} = Subscription.start_link({c.p, "Numbers"}, every: 3_600_000)
    settle(subscription)
    post(c, [1, 2])
    assert_receive {:situ, "Numbers", %Message{data: 1}}
    :ok = Subscription.request_next(subscription)
    assert eventually(fn -> match?(%{latest: %{data: 2}, next?: true}, settle(subscription)) end)
    refute_received {:situ, _, _}
    send(subscription, :due)
    assert_receive {:situ, "Numbers", %Message{data: 2}}
  end

  test "reports a missing stream and a missing pipeline once, and follows a pipeline by its function" do
    c = start_pipeline()
    {:ok, _} = Subscription.start_link({c.p, "Nubmers"})
    assert_receive {:situ, "Nubmers", %Error{code: :unknown_stream}}

    {:ok, current} = Agent.start_link(fn -> nil end)
    find = fn -> Agent.get(current, & &1) end
    {:ok, subscription} = Subscription.start_link({find, "Numbers"}, every: 0)
    assert_receive {:situ, "Numbers", %Error{code: :not_running}}
    send(subscription, :attach)
    settle(subscription)
    refute_received {:situ, _, _}
    Agent.update(current, fn nil -> c.p end)
    send(subscription, :attach)
    settle(subscription)
    post(c, [1])
    assert_receive {:situ, "Numbers", %Message{data: 1}}
  end

  test "ends with its process, and leaves no tap" do
    c = start_pipeline()
    me = self()

    owner =
      spawn(fn ->
        {:ok, subscription} = Subscription.start_link({c.p, "Numbers"})
        settle(subscription)
        send(me, :attached)
        receive do: (:end -> :ok)
      end)

    assert_receive :attached
    tapped? = fn -> Enum.any?(Pipeline.info(c.p).nodes, &(&1.kind == :tap)) end
    assert tapped?.()
    send(owner, :end)
    assert eventually(fn -> not tapped?.() end)
  end
end
