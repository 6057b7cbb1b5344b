defmodule Situ.Fusion.Zipper do
  @moduledoc false
  # The component behind zip.
  use Situ.Component,
    inputs: [],
    outputs: [out: :list],
    options: [inputs: [type: :pos_integer, required: true]]

  alias Situ.Fusion.{Balance, Fuse, Zip}

  defstruct [:zip, :inputs, :names, balance: %Balance{}]

  @impl true
  def init(opts) do
    names = Enum.map(0..(opts[:inputs] - 1), &Fuse.input/1)
    inputs = Map.new(Enum.with_index(names))
    {:ok, %__MODULE__{zip: Zip.new(opts[:inputs]), names: names, inputs: inputs}}
  end

  @impl true
  def handle_message(input, message, context, state),
    do: handle_messages(input, [message], context, state)

  @impl true
  def handle_messages(input, messages, _context, state) do
    state = %{state | balance: Balance.seen(state.balance, input, messages)}
    done(Zip.push(state.zip, Map.fetch!(state.inputs, input), messages), state)
  end

  @impl true
  def handle_closed(input, _time, _context, state),
    do: done(Zip.close(state.zip, Map.fetch!(state.inputs, input)), state)

  @impl true
  def handle_info({:hold_ended, input}, _context, state) do
    {actions, balance} = Balance.ended(state.balance, input, Balance.busy?())
    {actions, %{state | balance: balance}}
  end

  def handle_info(_other, _context, state), do: {[], state}

  defp done({outputs, zip}, state) do
    heads = Enum.zip(state.names, Zip.heads(zip))
    awaited = Enum.map(Zip.awaited(zip), &Enum.at(state.names, &1))

    case Balance.actions(state.balance, heads, awaited) do
      {[], balance} -> {outputs, %{state | zip: zip, balance: balance}}
      {actions, balance} -> {outputs ++ actions, %{state | zip: zip, balance: balance}}
    end
  end

  @impl true
  def describe(%{zip: zip}), do: "waiting: " <> Enum.join(Zip.queued(zip), " + ")
end
