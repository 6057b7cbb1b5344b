defmodule Situ.Fusion.Decision do
  @moduledoc false
  # Decides the waiting primaries of a fusion, oldest first, until one has to keep waiting. Pure.
  alias Situ.Component
  alias Situ.Fusion.{Core, Member, MessageQueue, SecondaryQueue}

  @spec decide_waiting(Core.t()) :: {[Component.action()], Core.t()}
  def decide_waiting(core), do: decide_queue(%{core | waiting: nil}, wait_limit(core), [])

  defp decide_queue(%{queue: {[], []}} = core, _limit, outputs),
    do: {:lists.reverse(outputs), core}

  defp decide_queue(%{queue: {[], _rear} = queue} = core, limit, outputs),
    do: decide_queue(%{core | queue: MessageQueue.merge_batches(queue)}, limit, outputs)

  defp decide_queue(%{queue: {front, rear}} = core, limit, outputs) do
    {front, members, waiting, outputs, given_up} = decide_front(front, core, limit, outputs)
    core = %{core | queue: {front, rear}, members: members, waiting: waiting, given_up: given_up}

    if front == [],
      do: decide_queue(core, limit, outputs),
      else: {:lists.reverse(outputs), core}
  end

  # Primaries before this time stop waiting: a much later one has arrived, or too many are waiting.
  defp wait_limit(%{give_up_after: nil, max_queue: nil}), do: nil

  defp wait_limit(core) do
    case {give_up_limit(core), queue_limit(core)} do
      {nil, limit} -> limit
      {limit, nil} -> limit
      {late, crowded} -> max(late, crowded)
    end
  end

  defp give_up_limit(%{give_up_after: nil}), do: nil
  defp give_up_limit(%{arrived: nil}), do: nil
  defp give_up_limit(core), do: core.arrived.originating_time - core.give_up_after

  defp queue_limit(%{arrived: nil}), do: nil

  defp queue_limit(core) do
    case MessageQueue.excess_count(core.queue, core.arrived.sequence_id, core.max_queue) do
      0 ->
        nil

      n ->
        core.queue
        |> MessageQueue.drop_first(n - 1)
        |> elem(0)
        |> hd()
        |> Map.fetch!(:originating_time)
        |> Kernel.+(1)
    end
  end

  # The common case, a single secondary that is always present, needs no lists of members.
  defp decide_front(front, %{values: :one, members: [member]} = core, limit, outputs) do
    context = {member.interpolator, core.creator, limit}

    {front, queue, waiting, outputs, given_up} =
      decide_single(front, member.queue, context, outputs, core.given_up)

    waiting = if waiting != nil, do: {member.input, elem(waiting, 1)}
    {front, [%{member | queue: queue}], waiting, outputs, given_up}
  end

  defp decide_front(front, core, limit, outputs),
    do: decide_several(front, core.members, {core, limit}, outputs, core.given_up)

  defp decide_single([], queue, _context, outputs, given_up),
    do: {[], queue, nil, outputs, given_up}

  defp decide_single([primary | rest] = front, queue, context, outputs, given_up) do
    {interpolator, creator, limit} = context
    time = primary.originating_time

    case SecondaryQueue.resolve_value(interpolator, time, queue, limit) do
      {:created, value, queue} ->
        output = {:out, time, creator.(primary.data, value)}
        decide_single(rest, queue, context, [output | outputs], given_up)

      {:does_not_exist, queue} ->
        decide_single(rest, queue, context, outputs, given_up)

      {:given_up, queue} ->
        decide_single(rest, queue, context, outputs, given_up + 1)

      {:wait, until, queue} ->
        {front, queue, {:wait, until}, outputs, given_up}
    end
  end

  defp decide_several([], members, _context, outputs, given_up),
    do: {[], members, nil, outputs, given_up}

  defp decide_several(
         [primary | rest] = front,
         members,
         {core, limit} = context,
         outputs,
         given_up
       ) do
    time = primary.originating_time

    case ask_members(members, time, limit, [], []) do
      {:all, values, members} ->
        output = {:out, time, core.creator.(primary.data, shape_values(core.values, values))}
        decide_several(rest, members, context, [output | outputs], given_up)

      {:none, members} ->
        decide_several(rest, members, context, outputs, given_up)

      {:given_up, members} ->
        decide_several(rest, members, context, outputs, given_up + 1)

      # The same primary will be decided again later, so its secondaries must stay unchanged.
      {:wait, waiting} ->
        {front, members, waiting, outputs, given_up}
    end
  end

  defp shape_values(:map, values), do: :maps.from_list(values)
  defp shape_values(:list, values), do: for({_key, value} <- :lists.reverse(values), do: value)

  # Collects the values of all members in reverse order. Each queue is trimmed according to its own result, even if
  # another member has no value, because later primaries cannot need a trimmed message either.
  defp ask_members([], _time, _limit, values, done), do: {:all, values, :lists.reverse(done)}

  defp ask_members([%Member{from: from} = member | rest], time, limit, values, done)
       when from != nil and time < from,
       do: ask_members(rest, time, limit, values, [member | done])

  # `nil`, an atom, sorts after every time.
  defp ask_members([%Member{until: until} = member | rest], time, limit, values, done)
       when time >= until,
       do: ask_members(rest, time, limit, values, [member | done])

  defp ask_members([member | rest], time, limit, values, done) do
    case SecondaryQueue.resolve_value(member.interpolator, time, member.queue, limit) do
      {:created, value, queue} ->
        ask_members(rest, time, limit, [{member.key, value} | values], [
          %{member | queue: queue} | done
        ])

      {:does_not_exist, queue} ->
        {:none, :lists.reverse(done, [%{member | queue: queue} | rest])}

      {:given_up, queue} ->
        {:given_up, :lists.reverse(done, [%{member | queue: queue} | rest])}

      {:wait, until, _queue} ->
        {:wait, {member.input, until}}
    end
  end
end
