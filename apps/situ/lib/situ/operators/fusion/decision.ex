defmodule Situ.Fusion.Decision do
  @moduledoc false
  # Decides the waiting primaries of a fusion, oldest first, until one has to keep waiting. Pure.
  alias Situ.Component
  alias Situ.Fusion.{Core, Member, MessageQueue, Secondary}

  @spec run(Core.t()) :: {[Component.action()], Core.t()}
  def run(core), do: run(%{core | waiting: nil}, limit(core), [])

  defp run(%{queue: {[], []}} = core, _limit, outputs), do: {:lists.reverse(outputs), core}

  defp run(%{queue: {[], _rear} = queue} = core, limit, outputs),
    do: run(%{core | queue: MessageQueue.whole(queue)}, limit, outputs)

  defp run(%{queue: {front, rear}} = core, limit, outputs) do
    {front, members, waiting, outputs, given_up} = decide(front, core, limit, outputs)
    core = %{core | queue: {front, rear}, members: members, waiting: waiting, given_up: given_up}

    if front == [],
      do: run(core, limit, outputs),
      else: {:lists.reverse(outputs), core}
  end

  # Primaries before this time stop waiting: a much later one has arrived, or too many are waiting.
  defp limit(%{give_up_after: nil, max_queue: nil}), do: nil

  defp limit(core) do
    case {late(core), crowded(core)} do
      {nil, limit} -> limit
      {limit, nil} -> limit
      {late, crowded} -> max(late, crowded)
    end
  end

  defp late(%{give_up_after: nil}), do: nil
  defp late(%{arrived: nil}), do: nil
  defp late(core), do: core.arrived.originating_time - core.give_up_after

  defp crowded(%{arrived: nil}), do: nil

  defp crowded(core) do
    case MessageQueue.excess(core.queue, core.arrived.sequence_id, core.max_queue) do
      0 ->
        nil

      n ->
        core.queue
        |> MessageQueue.drop(n - 1)
        |> elem(0)
        |> hd()
        |> Map.fetch!(:originating_time)
        |> Kernel.+(1)
    end
  end

  # The common case, a single secondary that is always present, needs no lists of members.
  defp decide(front, %{values: :one, members: [member]} = core, limit, outputs) do
    context = {member.interpolator, core.creator, limit}

    {front, queue, waiting, outputs, given_up} =
      single(front, member.queue, context, outputs, core.given_up)

    waiting = if waiting != nil, do: {member.input, elem(waiting, 1)}
    {front, [%{member | queue: queue}], waiting, outputs, given_up}
  end

  defp decide(front, core, limit, outputs),
    do: several(front, core.members, {core, limit}, outputs, core.given_up)

  defp single([], queue, _context, outputs, given_up), do: {[], queue, nil, outputs, given_up}

  defp single([primary | rest] = front, queue, context, outputs, given_up) do
    {interpolator, creator, limit} = context
    time = primary.originating_time

    case Secondary.ask(interpolator, time, queue, limit) do
      {:created, value, queue} ->
        output = {:out, time, creator.(primary.data, value)}
        single(rest, queue, context, [output | outputs], given_up)

      {:does_not_exist, queue} ->
        single(rest, queue, context, outputs, given_up)

      {:given_up, queue} ->
        single(rest, queue, context, outputs, given_up + 1)

      {:wait, until, queue} ->
        {front, queue, {:wait, until}, outputs, given_up}
    end
  end

  defp several([], members, _context, outputs, given_up),
    do: {[], members, nil, outputs, given_up}

  defp several([primary | rest] = front, members, {core, limit} = context, outputs, given_up) do
    time = primary.originating_time

    case ask(members, time, limit, [], []) do
      {:all, values, members} ->
        output = {:out, time, core.creator.(primary.data, shaped(core.values, values))}
        several(rest, members, context, [output | outputs], given_up)

      {:none, members} ->
        several(rest, members, context, outputs, given_up)

      {:given_up, members} ->
        several(rest, members, context, outputs, given_up + 1)

      # The same primary will be decided again later, so its secondaries must stay unchanged.
      {:wait, waiting} ->
        {front, members, waiting, outputs, given_up}
    end
  end

  defp shaped(:map, values), do: :maps.from_list(values)
  defp shaped(:list, values), do: for({_key, value} <- :lists.reverse(values), do: value)

  # Collects the values of all members in reverse order. Each queue is trimmed according to its own result, even if
  # another member has no value, because later primaries cannot need a trimmed message either.
  defp ask([], _time, _limit, values, done), do: {:all, values, :lists.reverse(done)}

  defp ask([%Member{from: from} = member | rest], time, limit, values, done)
       when from != nil and time < from,
       do: ask(rest, time, limit, values, [member | done])

  # `nil`, an atom, sorts after every time.
  defp ask([%Member{until: until} = member | rest], time, limit, values, done) when time >= until,
    do: ask(rest, time, limit, values, [member | done])

  defp ask([member | rest], time, limit, values, done) do
    case Secondary.ask(member.interpolator, time, member.queue, limit) do
      {:created, value, queue} ->
        ask(rest, time, limit, [{member.key, value} | values], [%{member | queue: queue} | done])

      {:does_not_exist, queue} ->
        {:none, :lists.reverse(done, [%{member | queue: queue} | rest])}

      {:given_up, queue} ->
        {:given_up, :lists.reverse(done, [%{member | queue: queue} | rest])}

      {:wait, until, _queue} ->
        {:wait, {member.input, until}}
    end
  end
end
