defmodule Situ.Connector.Receiver do
  @moduledoc false
  # The receiving side consumes from every sending side with GenStage's protocol; it is a source without an end.
  use Situ.Component,
    outputs: [out: :any],
    options: [
      connector: [type: {:struct, Situ.Connector}, required: true],
      as: [type: {:in, [:data, :message, :envelope]}, default: :data],
      window: [type: :pos_integer, default: 1_000]
    ]

  @impl true
  def init(opts), do: {:ok, opts |> Map.new() |> Map.put(:subs, %{})}

  @impl true
  def handle_start(_context, state) do
    senders = Situ.Connector.announce_receiver(state.connector)
    {[{:complete, :infinity}], Enum.reduce(senders, state, &subscribe_sender/2)}
  end

  # Both sides may have discovered each other at the same time.
  defp subscribe_sender(pid, state) do
    if Enum.any?(state.subs, fn {_, sub} -> sub.pid == pid end) do
      state
    else
      ref = Process.monitor(pid)
      Kernel.send(pid, {:"$gen_producer", {self(), ref}, {:subscribe, nil, []}})
      Kernel.send(pid, {:"$gen_producer", {self(), ref}, {:ask, state.window}})
      Kernel.send(pid, {:situ_connector_joined, self()})
      put_in(state.subs[ref], %{pid: pid, taken: 0})
    end
  end

  # The pipeline has room, so request as many messages as were received.
  @impl true
  def handle_demand(_n, _context, state) do
    {[],
     %{
       state
       | subs: Map.new(state.subs, fn {ref, sub} -> {ref, request_more(ref, sub, state)} end)
     }}
  end

  defp request_more(ref, %{taken: taken} = sub, %{window: window})
       when taken > 0 and taken >= div(window, 2) do
    Kernel.send(sub.pid, {:"$gen_producer", {self(), ref}, {:ask, taken}})
    %{sub | taken: 0}
  end

  defp request_more(_ref, sub, _state), do: sub

  @impl true
  def handle_info({:"$gen_consumer", {_pid, ref}, {:cancel, _reason}}, _context, state)
      when is_map_key(state.subs, ref) do
    Process.demonitor(ref, [:flush])
    {[], %{state | subs: Map.delete(state.subs, ref)}}
  end

  def handle_info({:"$gen_consumer", {_pid, ref}, messages}, _context, state)
      when is_map_key(state.subs, ref),
      do:
        {message_actions(messages, state.as),
         update_in(state.subs[ref].taken, &(&1 + length(messages)))}

  def handle_info({:DOWN, ref, :process, _pid, _reason}, _context, state),
    do: {[], %{state | subs: Map.delete(state.subs, ref)}}

  def handle_info({:situ_connector_offer, pid}, _context, state),
    do: {[], subscribe_sender(pid, state)}

  def handle_info({:situ_connector, _ref, messages}, _context, state),
    do: {message_actions(messages, state.as), state}

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def handle_stop(_final, _context, state), do: {[], cancel_subscriptions(state)}

  @impl true
  def terminate(_reason, state), do: cancel_subscriptions(state)

  defp cancel_subscriptions(state) do
    for {ref, sub} <- state.subs,
        do: Kernel.send(sub.pid, {:"$gen_producer", {self(), ref}, {:cancel, :normal}})

    %{state | subs: %{}}
  end

  defp message_actions(messages, :envelope), do: [{:out, messages}]

  defp message_actions(messages, :data),
    do: for(m <- messages, do: {:out, m.originating_time, m.data})

  defp message_actions(messages, :message),
    do: for(m <- messages, do: {:out, m.originating_time, m})
end
