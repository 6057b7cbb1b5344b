defmodule Situ.Fusion.Fuse do
  @moduledoc false
  # The component behind join, fuse, interpolate and sample by a clock: input :primary, and secondaries :s0, :s1 ...
  use Situ.Component,
    inputs: [],
    outputs: [out: :any],
    options: [
      interpolators: [type: {:list, {:struct, Situ.Interpolator}}, required: true],
      creator: [type: {:fun, 2}, required: true],
      give_up_after: [type: {:optional, :pos_integer}]
    ]

  alias Situ.Fusion.{Balance, Core}

  @doc "The input's name of secondary number `index`. Graphs are built by programs: the atoms are as few as their inputs."
  @spec input(non_neg_integer()) :: atom()
  def input(index), do: :"s#{index}"

  defstruct [:core, :inputs, :names, balance: %Balance{}]

  @impl true
  def init(opts) do
    names = for {_, index} <- Enum.with_index(opts[:interpolators]), do: input(index)
    give_up = [give_up_after: opts[:give_up_after]]
    core = Core.new(opts[:interpolators], opts[:creator], give_up)
    {:ok, %__MODULE__{core: core, names: names, inputs: Map.new(Enum.with_index(names))}}
  end

  @impl true
  def handle_message(input, message, context, state),
    do: handle_messages(input, [message], context, state)

  @impl true
  def handle_messages(:primary, messages, _context, state),
    do: done(Core.primary(state.core, messages), seen(state, :primary, messages))

  def handle_messages(input, messages, _context, state) do
    index = Map.fetch!(state.inputs, input)
    done(Core.secondary(state.core, index, messages), seen(state, input, messages))
  end

  # Primaries that still wait are decided by their secondaries alone.
  @impl true
  def handle_closed(:primary, _time, _context, state), do: done({[], state.core}, state)

  def handle_closed(input, time, _context, state),
    do: done(Core.close(state.core, Map.fetch!(state.inputs, input), time), state)

  @impl true
  def handle_info({:hold_ended, input}, _context, state) do
    {actions, balance} = Balance.ended(state.balance, input, Balance.busy?())
    {actions, %{state | balance: balance}}
  end

  def handle_info(_other, _context, state), do: {[], state}

  defp seen(state, input, messages),
    do: %{state | balance: Balance.seen(state.balance, input, messages)}

  defp done({outputs, core}, state) do
    {primary, secondaries} = Core.heads(core)
    heads = [{:primary, primary} | Enum.zip(state.names, secondaries)]

    case Balance.actions(state.balance, heads, [awaited(core, state.names)]) do
      {[], balance} -> {outputs, %{state | core: core, balance: balance}}
      {actions, balance} -> {outputs ++ actions, %{state | core: core, balance: balance}}
    end
  end

  defp awaited(core, names) do
    case Core.awaited(core) do
      :primary -> :primary
      index -> Enum.at(names, index)
    end
  end

  @impl true
  def describe(%{core: core}) do
    queued = Core.queued(core)
    given_up = if queued.given_up > 0, do: ", #{queued.given_up} given up", else: ""

    "waiting: #{queued.primary} primary, #{Enum.join(queued.secondary, " + ")} secondary#{given_up}"
  end
end
