defmodule Situ.Fusion.Gather do
  @moduledoc false
  # The component behind join and fuse over a map of secondaries: input :primary, and :s0, :s1 ... which come and go.
  use Situ.Component,
    inputs: [primary: :any],
    outputs: [out: :any],
    options: [
      members: [type: :list, required: true, doc: "{input, key, interpolator, span} of each."],
      interpolator: [type: {:struct, Situ.Interpolator}, required: true],
      creator: [type: {:fun, 2}, required: true],
      reproducible: [type: :boolean, default: false],
      give_up_after: [type: {:optional, :pos_integer}],
      ended: [type: {:in, [:stay, :leave]}, default: :stay]
    ]

  alias Situ.Fusion.{Balance, Build, Members, Span}
  alias Situ.{Interpolator, Options}

  @adding [
    from: [type: :time_ns],
    interpolator: [type: :any]
  ]
  @removing [until: [type: :time_ns]]

  defstruct [:members, :opts, balance: %Balance{}]

  @impl true
  def init(opts) do
    start = Members.new(opts[:creator], opts)

    members =
      Enum.reduce(opts[:members], start, fn {input, key, interpolator, span}, members ->
        {:ok, _, members} = Members.add(members, input, key, interpolator, span)
        members
      end)

    {:ok, %__MODULE__{members: members, opts: opts}}
  end

  @impl true
  def handle_message(input, message, context, state),
    do: handle_messages(input, [message], context, state)

  @impl true
  def handle_messages(:primary, messages, _context, state),
    do: done(Members.primary(state.members, messages), seen(state, :primary, messages))

  def handle_messages(input, messages, _context, state),
    do: done(Members.secondary(state.members, input, messages), seen(state, input, messages))

  @impl true
  def handle_closed(:primary, _time, _context, state),
    do: done({[], Members.close_primary(state.members)}, state)

  def handle_closed(input, time, _context, state),
    do: done(Members.close(state.members, input, time), state)

  @impl true
  def handle_attach(input, {key, opts}, last, _context, state) do
    with {:ok, opts} <- Options.validate(opts, @adding),
         {:ok, interpolator} <- interpolator(opts[:interpolator], state.opts),
         span = [from: opts[:from], after: last],
         {:ok, from, members} <- Members.add(state.members, input, key, interpolator, span) do
      entry = {input, key, interpolator, if(from == :start, do: [], else: [from: from])}
      opts = Keyword.update!(state.opts, :members, &(&1 ++ [entry]))
      {:ok, from, opts, [], %{state | members: members, opts: opts}}
    end
  end

  @impl true
  def handle_detach({key, opts}, _context, state) do
    with {:ok, opts} <- Options.validate(opts, @removing),
         {:ok, until, outputs, members} <- Members.remove(state.members, key, opts) do
      opts = Keyword.update!(state.opts, :members, &leaving(&1, key, until))
      {actions, state} = done({outputs, members}, %{state | opts: opts})
      {:ok, until, state.opts, actions, state}
    end
  end

  @impl true
  def handle_info({:hold_ended, input}, _context, state) do
    {actions, balance} = Balance.ended(state.balance, input, Balance.busy?())
    {actions, %{state | balance: balance}}
  end

  def handle_info(_other, _context, state), do: {[], state}

  defp leaving(entries, key, until) do
    Enum.map(entries, fn
      {input, ^key, interpolator, span} ->
        {input, key, interpolator, Keyword.put_new(span, :until, time(until))}

      other ->
        other
    end)
  end

  defp time(:start), do: Span.beginning()
  defp time(until), do: until

  defp interpolator(nil, own), do: {:ok, own[:interpolator]}

  defp interpolator(given, own) do
    interpolator = Interpolator.from(given)

    if own[:reproducible] and not interpolator.reproducible,
      do: {:error, Build.not_reproducible(interpolator)},
      else: {:ok, interpolator}
  end

  defp seen(state, input, messages),
    do: %{state | balance: Balance.seen(state.balance, input, messages)}

  defp done({outputs, members}, state) do
    {gone, members} = Members.gone(members)
    state = Enum.reduce(gone, %{state | members: members}, &forget/2)
    leave = for input <- gone, do: {:detach, input, state.opts}

    {actions, balance} =
      Balance.actions(state.balance, Members.heads(members), [Members.awaited(members)])

    {outputs ++ leave ++ actions, %{state | balance: balance}}
  end

  defp forget(input, state) do
    opts = Keyword.update!(state.opts, :members, &List.keydelete(&1, input, 0))
    %{state | opts: opts, balance: Balance.forget(state.balance, input)}
  end

  @impl true
  def describe(%{members: members}) do
    queued = Members.queued(members)
    given_up = if queued.given_up > 0, do: ", #{queued.given_up} given up", else: ""

    inputs =
      Enum.map_join(Enum.take(queued.secondary, 8), ", ", fn {key, n} ->
        "#{inspect(key)} #{n}"
      end)

    "#{map_size(queued.secondary)} inputs; waiting: primary #{queued.primary}, #{inputs}#{given_up}"
  end
end
