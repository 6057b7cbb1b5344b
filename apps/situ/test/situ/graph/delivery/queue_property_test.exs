defmodule Situ.Delivery.QueuePropertyTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Delivery, Message, Pipeline}
  alias Situ.Delivery.Queue
  alias Situ.Fixture.Count
  alias Situ.Ports.{Output, PostingRules, Subscriber}

  # Represents a policy as plain data so that it can shrink: {max_queue | nil, max_latency | nil, guarantee even?}.
  defp policy({max, latency, guarantee}) do
    base = if max == 0, do: Delivery.unlimited(), else: Delivery.max_queue(max)
    base = if latency == 0, do: base, else: %{base | max_latency: latency}
    if guarantee, do: Delivery.with_guarantee(base, &(rem(&1, 2) == 0)), else: base
  end

  property "a queue reports every loss and keeps its order, size limit and guarantees",
    numtests: 300 do
    forall {spec, steps} <- {{integer(0, 4), integer(0, 6), boolean()}, list(integer(0, 2))} do
      policy = policy(spec)

      {queue, out, lost, n} =
        Enum.reduce(steps, {Queue.new(policy), [], [], 0}, &step(&1, &2, policy))

      waiting = Queue.to_list(queue)
      assert Enum.sort(Enum.map(out ++ lost ++ waiting, & &1.data)) == Enum.to_list(1..n//1)
      taken = Enum.map(Enum.reverse(out) ++ waiting, & &1.data)
      assert taken == Enum.sort(taken)
      assert queue.size == length(waiting)
      if policy.guarantee, do: assert(Enum.all?(lost, &(rem(&1.data, 2) == 1)))

      if policy.max_queue != :infinity and policy.guarantee == nil,
        do: assert(length(waiting) <= policy.max_queue)
    end
  end

  # Steps 0 and 1 push, step 2 pops; a message's time is its number.
  defp step(2, {queue, out, lost, n}, _policy) do
    {entry, queue, dropped} = Queue.pop(queue, n)
    {queue, if(entry, do: [entry | out], else: out), dropped ++ lost, n}
  end

  defp step(_push, {queue, out, lost, n}, _policy) do
    {queue, dropped} = Queue.push(queue, %Message{data: n + 1, originating_time: n + 1})
    {queue, out, dropped ++ lost, n + 1}
  end

  property "an output emits no more than requested, in order, and everything before it ends" do
    forall steps <- list({boolean(), integer(1, 5)}) do
      tag = make_ref()

      start = %{
        Output.new(:out, "P", 1)
        | subs: [Subscriber.new(tag, self(), nil)]
      }

      {outlet, sent, asked} =
        Enum.reduce(steps, {start, 0, 0}, fn
          {true, n}, {outlet, sent, asked} ->
            {post(outlet, sent, n), sent + n, asked}

          {false, n}, {outlet, sent, asked} ->
            {ask(outlet, tag, n), sent, asked + n}
        end)

      got = received(tag)
      assert got == Enum.to_list(1..min(sent, asked)//1)
      outlet |> Output.close(sent + 1) |> ask(tag, sent + 1)
      assert got ++ received(tag) == Enum.to_list(1..sent//1)
      assert_received {:"$gen_consumer", {_, ^tag}, {:cancel, {:shutdown, {:closed, _}}}}
    end
  end

  defp ask(outlet, tag, n) do
    case Output.add_demand(outlet, {self(), tag}, n) do
      {:ok, outlet} -> outlet
      # The output is closed and has no subscribers left.
      :error -> outlet
    end
  end

  defp post(outlet, sent, n) do
    Enum.reduce((sent + 1)..(sent + n), outlet, fn i, outlet ->
      {:ok, outlet} = PostingRules.emit(outlet, i, i, 0, false)
      outlet
    end)
    |> Output.flush(0)
  end

  defp received(tag) do
    receive do
      {:"$gen_consumer", {_, ^tag}, list} when is_list(list) ->
        Enum.map(list, & &1.data) ++ received(tag)
    after
      0 -> []
    end
  end

  property "any mixture of lossless policies loses nothing and keeps the order", numtests: 40 do
    forall kinds <- list(integer(0, 4)) do
      me = self()
      tag = make_ref()

      {:ok, report} =
        Pipeline.run(fn p ->
          kinds
          |> Enum.reduce(Situ.source(p, Count, count: 1_500), fn kind, stream ->
            Situ.map(stream, & &1, lossless(kind))
          end)
          |> Situ.each(&send(me, {tag, &1}))
        end)

      assert report.errors == []
      assert values(tag) == Enum.to_list(0..1_499)
    end
  end

  defp lossless(0), do: []
  defp lossless(1), do: [policy: Delivery.unlimited()]
  defp lossless(2), do: [policy: Delivery.throttle(3)]
  defp lossless(3), do: [policy: Delivery.synchronous()]
  defp lossless(4), do: [async: true]

  defp values(tag) do
    receive do
      {^tag, value} -> [value | values(tag)]
    after
      0 -> []
    end
  end
end
