defmodule Situ.Fusion.FuseComponent do
  @moduledoc false
  # The component of join, fuse, and interpolate and sample with a clock. Its inputs are :primary and the secondaries
  # :s0, :s1 ..., which can be added and removed if their values form a map.
  use Situ.Component,
    share_process: true,
    inputs: [],
    outputs: [out: :any],
    options: [
      members: [
        type: :list,
        required: true,
        doc: "`{input, key, interpolator, span}` of each member."
      ],
      values: [type: {:in, [:one, :list, :map]}, required: true],
      interpolator: [
        type: {:optional, {:struct, Situ.Interpolator}},
        doc: "Interpolator of added inputs."
      ],
      creator: [type: {:fun, 2}, required: true],
      reproducible: [type: :boolean, default: false],
      give_up_after: [type: {:optional, :pos_integer}],
      max_queue: [type: {:optional, :pos_integer}],
      ended: [type: {:in, [:stay, :leave]}, default: :stay]
    ]

  alias Situ.Fusion.{Arguments, Balance, Core, Span}
  alias Situ.{Error, Options}

  @core [:members, :values, :give_up_after, :max_queue, :ended]
  @adding [from: [type: :time_ns], interpolator: [type: :any]]
  @removing [until: [type: :time_ns]]

  defstruct [:core, :opts, :balance]

  @impl true
  def init(opts) do
    core = Core.new(opts[:creator], Keyword.take(opts, @core))
    {:ok, %__MODULE__{core: core, opts: opts, balance: Balance.new(opts[:max_queue])}}
  end

  @impl true
  def handle_message(input, message, context, state),
    do: handle_messages(input, [message], context, state)

  @impl true
  def handle_messages(:primary, messages, _context, state),
    do:
      finish_step(
        Core.push_primary(state.core, messages),
        note_arrival(state, :primary, messages)
      )

  def handle_messages(input, messages, _context, state),
    do:
      finish_step(
        Core.push_secondary(state.core, input, messages),
        note_arrival(state, input, messages)
      )

  @impl true
  def handle_closed(:primary, _time, _context, state),
    do: finish_step({[], Core.close_primary(state.core)}, state)

  def handle_closed(input, time, _context, state),
    do: finish_step(Core.close_secondary(state.core, input, time), state)

  @impl true
  def reopen(state), do: %{state | core: Core.reopen(state.core)}

  @impl true
  def handle_attach(input, {key, opts}, last, _context, state) do
    with :ok <- check_keyed(state),
         {:ok, opts} <- Options.validate(opts, @adding),
         {:ok, interpolator} <- resolve_interpolator(opts[:interpolator], state.opts),
         span = [from: opts[:from], after: last],
         {:ok, from, core} <- Core.add_member(state.core, input, key, interpolator, span) do
      entry = {input, key, interpolator, if(from == :start, do: [], else: [from: from])}
      opts = Keyword.update!(state.opts, :members, &(&1 ++ [entry]))
      {:ok, from, opts, [], %{state | core: core, opts: opts}}
    end
  end

  @impl true
  def handle_detach({key, opts}, _context, state) do
    with :ok <- check_keyed(state),
         {:ok, opts} <- Options.validate(opts, @removing),
         {:ok, until, outputs, core} <- Core.remove_member(state.core, key, opts) do
      opts = Keyword.update!(state.opts, :members, &put_until(&1, key, until))
      {actions, state} = finish_step({outputs, core}, %{state | opts: opts})
      {:ok, until, state.opts, actions, state}
    end
  end

  @impl true
  def handle_info(message, _context, state), do: Balance.handle_info(message, state)

  defp check_keyed(%{opts: opts}) do
    if opts[:values] == :map,
      do: :ok,
      else:
        {:error,
         Error.new(:fixed_inputs, "the inputs of this operator are fixed",
           fix: "join a map of streams"
         )}
  end

  defp put_until(entries, key, until) do
    until = if until == :start, do: Span.before_all_times(), else: until

    Enum.map(entries, fn
      {input, ^key, interpolator, span} ->
        {input, key, interpolator, Keyword.put_new(span, :until, until)}

      other ->
        other
    end)
  end

  defp resolve_interpolator(nil, own), do: {:ok, own[:interpolator]}

  defp resolve_interpolator(interpolator, own) do
    interpolator = Arguments.to_interpolator(interpolator)

    if own[:reproducible] and not interpolator.reproducible,
      do: {:error, Arguments.not_reproducible_error(interpolator)},
      else: {:ok, interpolator}
  end

  defp note_arrival(state, input, messages),
    do: %{state | balance: Balance.note_arrival(state.balance, input, messages)}

  defp finish_step({outputs, core}, state) do
    {finished, core} = Core.take_finished_inputs(core)
    state = Enum.reduce(finished, %{state | core: core}, &forget_input/2)
    leave = for input <- finished, do: {:detach, input, state.opts}
    Balance.after_step(outputs ++ leave, state, Core.head_ids(core), [Core.awaited_input(core)])
  end

  defp forget_input(input, state) do
    opts = Keyword.update!(state.opts, :members, &List.keydelete(&1, input, 0))
    %{state | opts: opts, balance: Balance.forget_input(state.balance, input)}
  end

  @impl true
  def describe(%{core: core}) do
    queued = Core.queue_lengths(core)
    named? = core.values == :map

    waiting =
      Enum.map_join(Enum.take(queued.secondary, 8), " + ", fn {key, n} ->
        if named?, do: "#{n} of #{inspect(key)}", else: "#{n}"
      end)

    given_up = if core.given_up > 0, do: ", #{core.given_up} given up", else: ""
    dropped = if core.dropped > 0, do: ", #{core.dropped} secondary dropped", else: ""
    "waiting: #{queued.primary} primary, #{waiting} secondary#{given_up}#{dropped}"
  end
end
