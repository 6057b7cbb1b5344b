defmodule Situ.Fusion.ZipComponent do
  @moduledoc false
  # The component of zip.
  use Situ.Component,
    share_process: true,
    inputs: [],
    outputs: [out: :list],
    options: [names: [type: {:list, :atom}, required: true]]

  alias Situ.Fusion.{Balance, Zip}

  defstruct [:zip, :indices, :names, :balance]

  @impl true
  def init(opts) do
    names = opts[:names]
    indices = Map.new(Enum.with_index(names))
    zip = Zip.new(length(names))
    {:ok, %__MODULE__{zip: zip, names: names, indices: indices, balance: Balance.new(nil)}}
  end

  @impl true
  def handle_message(input, message, context, state),
    do: handle_messages(input, [message], context, state)

  @impl true
  def handle_messages(input, messages, _context, state) do
    state = %{state | balance: Balance.note_arrival(state.balance, input, messages)}
    finish_step(Zip.push(state.zip, Map.fetch!(state.indices, input), messages), state)
  end

  @impl true
  def handle_closed(input, _time, _context, state),
    do: finish_step(Zip.close(state.zip, Map.fetch!(state.indices, input)), state)

  @impl true
  def reopen(state), do: %{state | zip: Zip.reopen(state.zip)}

  @impl true
  def handle_info(message, _context, state), do: Balance.handle_info(message, state)

  defp finish_step({outputs, zip}, state) do
    heads = Enum.zip(state.names, Zip.head_ids(zip))
    awaited = Enum.map(Zip.awaited_indices(zip), &Enum.at(state.names, &1))
    Balance.after_step(outputs, %{state | zip: zip}, heads, awaited)
  end

  @impl true
  def describe(%{zip: zip}), do: "waiting: " <> Enum.join(Zip.queue_lengths(zip), " + ")
end
