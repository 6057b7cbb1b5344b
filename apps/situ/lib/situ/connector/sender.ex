defmodule Situ.Connector.Sender do
  @moduledoc false
  # The sending side: its output has consumers outside the pipeline. It holds its messages back until every running
  # receiving side has subscribed.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [connector: [type: {:struct, Situ.Connector}, required: true]]

  @impl true
  def init(opts), do: {:ok, %{connector: opts[:connector], awaited: %{}}}

  @impl true
  def handle_start(_context, state) do
    awaited = Map.new(Situ.Connector.announce_sender(state.connector), &{&1, Process.monitor(&1)})
    {if(awaited == %{}, do: [], else: [{:demand, :accumulate}]), %{state | awaited: awaited}}
  end

  @impl true
  def handle_info({:situ_connector_joined, pid}, _context, state), do: remove_awaited(pid, state)
  def handle_info({:DOWN, _, :process, pid, _}, _context, state), do: remove_awaited(pid, state)
  def handle_info(_other, _context, state), do: {[], state}

  defp remove_awaited(pid, state) do
    case Map.pop(state.awaited, pid) do
      {nil, _} ->
        {[], state}

      {monitor, awaited} ->
        Process.demonitor(monitor, [:flush])
        {if(awaited == %{}, do: [{:demand, :forward}], else: []), %{state | awaited: awaited}}
    end
  end

  @impl true
  def handle_message(:in, message, _context, state), do: {[{:out, message}], state}

  @impl true
  def handle_messages(:in, messages, _context, state), do: {[{:out, messages}], state}
end
