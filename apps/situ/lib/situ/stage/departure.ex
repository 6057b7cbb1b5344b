defmodule Situ.Stage.Departure do
  @moduledoc false
  # The part of a shared process in the move of a stage to its own process (see Relocation).
  alias Situ.Stage.{Load, Relocation, SharedProcess, State, Step}

  # Time slices that did not finish until the load is checked.
  @check_every 8

  @doc """
  Counts a time slice that did not finish. After several of them, the stage with the largest share leaves the process if
  it is heavy.
  """
  @spec check_load(SharedProcess.t()) :: SharedProcess.t()
  def check_load(%{saturated: n} = process) when n < @check_every,
    do: %{process | saturated: n + 1}

  def check_load(%{members: members} = process) when map_size(members) > 1 do
    {id, state} = Enum.max_by(members, fn {_id, state} -> state.load.busy end)
    heavy? = Load.heavy?(state)
    members = Map.new(members, fn {id, state} -> {id, Load.start_check(state)} end)
    process = %{process | members: members, saturated: 0}
    if heavy?, do: begin(process, id, members[id]), else: process
  end

  def check_load(process), do: %{process | saturated: 0}

  @doc "Begins to move a stage, with its present state, to its own process. The last stage has nobody to delay."
  @spec begin(SharedProcess.t(), pos_integer(), State.t()) :: SharedProcess.t()
  def begin(%{members: members} = process, id, state) do
    if map_size(members) > 1 and not is_map_key(process.paused, id) and Relocation.movable?(state) do
      {moving, relays} = Relocation.prepare_state(state, self())
      Step.report_event(elem(state.steps, 0), {:relocating, moving})
      inputs = for step <- State.list_steps(state), {tag, _} <- step.inputs.by_tag, do: {tag, id}
      outputs = for sub <- State.list_subscribers(state), do: {sub.tag, id}

      %{
        process
        | members: Map.delete(members, id),
          leaving: Map.put(process.leaving, id, {:kept, []}),
          consumers: Enum.into(inputs, process.consumers),
          producers: Enum.into(outputs, process.producers),
          relays: Map.merge(process.relays, relays)
      }
    else
      %{process | members: %{members | id => state}}
    end
  end

  @doc "Forwards the kept messages to the new process of a stage."
  @spec finish(SharedProcess.t(), pos_integer(), pid()) :: SharedProcess.t()
  # Messages that still wait for the stage come before messages that its neighbors will send to the new process.
  def finish(%{waiting: waiting} = process, id, pid) do
    {own, waiting} = Enum.split_with(waiting, &match?({^id, _message}, &1))
    process = %{process | waiting: waiting}
    forward_own = fn {_id, message}, process -> forward(process, id, message) end
    %{leaving: leaving} = process = Enum.reduce(own, process, forward_own)
    {:kept, kept} = Map.fetch!(leaving, id)
    for message <- Enum.reverse(kept), do: send(pid, {:situ_forwarded, message})
    send(pid, :situ_forwarding_ended)
    Process.monitor(pid)

    members =
      Map.new(process.members, fn {other, state} ->
        {other, Relocation.readdress_neighbor(state, id, pid)}
      end)

    %{process | members: members, leaving: Map.put(leaving, id, {:moved, pid})}
  end

  @doc "Forwards a message to a stage that has left; other messages are for a stage that has ended."
  @spec forward(SharedProcess.t(), pos_integer(), term()) :: SharedProcess.t()
  # Connections that are made meanwhile are known by the requests for them.
  def forward(%{leaving: leaving} = process, id, message) when is_map_key(leaving, id) do
    case message do
      :situ_turn ->
        process

      {:situ, {:forward, request}} ->
        forward_message(process, id, {:situ, request})

      {:situ, {:lend, tag, _output, _pid, _counters, _policy}} ->
        forward_message(put_in(process.producers[tag], id), id, message)

      {:situ, {:tap, %{tag: tag}}} ->
        forward_message(put_in(process.producers[tag], id), id, message)

      {:situ, {:attach, _request, _last, %{tag: tag}}} ->
        forward_message(put_in(process.consumers[tag], id), id, message)

      {:situ, {:peer, tag, pid, closing}} when :erlang.map_get(tag, process.consumers) == id ->
        forward_peer(process, id, {tag, pid, closing})

      {:"$gen_producer", {_address, tag} = from, request} ->
        from = if is_map_key(process.relays, {:consumer, tag}), do: {self(), tag}, else: from
        forward_message(process, id, {:"$gen_producer", from, request})

      message ->
        forward_message(process, id, message)
    end
  end

  def forward(process, _has_ended, _message), do: process

  # The new process of a producer knows the stage in this process.
  defp forward_peer(process, id, {tag, pid, closing}) do
    process = put_in(process.relays[{:producer, tag}], pid)
    forward_message(process, id, {:situ, {:peer, tag, {:relay, self()}, closing}})
  end

  defp forward_message(%{leaving: leaving} = process, id, message) do
    case leaving do
      %{^id => {:kept, kept}} ->
        %{process | leaving: %{leaving | id => {:kept, [message | kept]}}}

      %{^id => {:moved, pid}} ->
        send(pid, message)
        process
    end
  end
end
