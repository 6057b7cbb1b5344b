defmodule Situ.Cluster.InletComponentTest do
  use ExUnit.Case, async: true

  alias Situ.Cluster.InletComponent
  alias Situ.Message

  defp inlet do
    {:ok, state} = InletComponent.init(agent: self(), part: {"d", "p"}, stream: "s", reader: "q")

    {[], state} =
      InletComponent.handle_info({:situ_cluster, :publisher, {"d", "p"}, self()}, nil, state)

    state
  end

  defp message(id, made),
    do: %Message{
      data: id,
      originating_time: id,
      creation_time: made,
      sequence_id: id,
      source_id: 0
    }

  defp given(state, messages),
    do:
      InletComponent.handle_info(
        {:"$gen_consumer", {self(), state.sub.ref}, messages},
        nil,
        state
      )

  test "asks for a few messages, and for more when it knows their size" do
    state = inlet()
    assert_receive {:"$gen_producer", _, {:subscribe, nil, opts}}
    assert {opts[:stream], opts[:from]} == {"s", 0}
    assert_receive {:"$gen_producer", _, {:ask, 4}}
    {_, state} = given(state, [message(1, 1), message(2, 2)])
    {[], _} = InletComponent.handle_demand(1, nil, state)
    assert_receive {:"$gen_producer", _, {:ask, 3998}}
  end

  test "skips known messages, and creation times do not go back when a part repeats them" do
    {[{:out, first}], state} = given(inlet(), [message(1, 10), message(2, 500)])
    assert for(m <- first, do: m.creation_time) == [10, 500]
    {[{:out, again}], state} = given(state, [message(2, 300), message(3, 400), message(4, 600)])
    assert for(m <- again, do: {m.data, m.creation_time}) == [{3, 500}, {4, 600}]
    # The same holds when the inlet itself restarts.
    {:ok, memory} = InletComponent.snapshot(state)
    {:ok, fresh} = InletComponent.restore(memory, inlet())
    {[{:out, more}], _} = given(fresh, [message(4, 1), message(5, 2)])
    assert for(m <- more, do: {m.data, m.creation_time}) == [{5, 600}]
  end

  test "an entry missing in the log is an error, not a gap" do
    {[{:out, _}], state} = given(inlet(), [message(1, 10)])
    error = assert_raise Situ.Error, fn -> given(state, [message(4, 20)]) end
    assert {error.code, error.what} == {:log_trimmed, "2 messages of s are missing in the log"}
  end

  test "a direct stream continues with new messages, numbered here" do
    {:ok, state} =
      InletComponent.init(agent: self(), part: {"d", "p"}, stream: "s", reader: "q", direct: true)

    {[], state} =
      InletComponent.handle_info({:situ_cluster, :publisher, {"d", "p"}, self()}, nil, state)

    {[{:out, first}], state} = given(state, [message(1, 10), message(4, 20)])
    assert for(m <- first, do: {m.data, m.sequence_id}) == [{1, 1}, {4, 2}]
    # Its part was restarted elsewhere and counts from one again.
    again = for {time, id} <- [{3, 1}, {4, 2}, {9, 3}], do: %{message(time, 30) | sequence_id: id}
    {[{:out, more}], _} = given(state, again)
    assert for(m <- more, do: {m.data, m.sequence_id}) == [{9, 3}]
  end

  test "accepts batches as they were packed for the log" do
    batch = Situ.Cluster.MessageBatch.pack_messages([message(1, 10), message(2, 20)])
    packed = {:situ_batch, batch.first, batch.body}
    state = inlet()

    {[{:out, all}], _} =
      InletComponent.handle_info({:"$gen_consumer", {self(), state.sub.ref}, packed}, nil, state)

    assert all == [message(1, 10), message(2, 20)]
  end

  defmodule Far do
    use Situ.Pipeline

    @impl true
    def build(p, _opts) do
      p
      |> Situ.sequence(1, &(&1 + 1), every: 1_000_000, name: "Made")
      |> Situ.composite("Far", &Situ.map(&1, fn n -> n + 1 end))
      |> Situ.map(& &1, name: "Here")
    end
  end

  # This process acts as the agent, the previous part and the publisher.
  test "a message waits for nothing here, whatever clock its time comes from" do
    alias Situ.Cluster.{PartStarter, Deployment}
    {:ok, deployment} = Deployment.new(Far, place: [{"Far", []}])
    {:ok, plan} = PartStarter.build_plan(deployment)
    links = %{agent: self(), publisher: self(), memories: %{}}
    {:ok, pipeline} = PartStarter.start_part(deployment, plan, "Far", links)
    assert_receive {:situ_cluster, :follow, part, inlet}, 60_000
    send(inlet, {:situ_cluster, :publisher, part, self()})
    assert_receive {:"$gen_producer", {^inlet, ref}, {:subscribe, nil, _}}, 60_000
    ahead = Situ.Time.now() + Situ.Time.h(1)
    message = %{message(1, ahead) | originating_time: ahead}
    send(inlet, {:"$gen_consumer", {self(), ref}, [message]})

    assert_receive {:"$gen_call", _, {:publish, _, [%{data: 2, originating_time: ^ahead}]}},
                   60_000

    Process.exit(pipeline, :kill)
  end
end
