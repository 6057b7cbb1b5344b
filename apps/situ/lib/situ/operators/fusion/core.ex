defmodule Situ.Fusion.Core do
  @moduledoc """
  The pure core of fusion: one queue of primary messages, one per secondary stream, and the rule that pairs them.

  Each arrival tries to complete the oldest primary: each secondary's interpolator gives a value at its time.

    * All have one: an output at the primary's originating time.
    * One cannot say yet: the primary waits, and later ones behind it, so outputs come in the primaries' order.
    * One has none: the primary is dropped.

  Secondary messages that no later primary can need are dropped at once, so memory is bounded by the messages that
  are undecided.

      iex> core = Situ.Fusion.Core.new(&{&1, &2}, members: [{:s0, 0, Situ.Reproducible.exact(), []}], values: :one)
      iex> message = &%Situ.Message{originating_time: &1, data: &2}
      iex> {[], core} = Situ.Fusion.Core.primary(core, [message.(1, :a), message.(2, :b)])
      iex> {outputs, _core} = Situ.Fusion.Core.secondary(core, :s0, [message.(2, :x)])
      iex> outputs
      [{:out, 2, {:b, :x}}]

  Secondaries may come and go. Each takes part for a span of originating times: a primary at time t needs a value of
  every member with `from <= t < until`, and of no other; of a member's messages those before `from` are as if they
  had never been. So the outputs depend on the spans alone, and not on when a member was added or removed, as long
  as no primary of the span had arrived before: `add/5` and `remove/3` refuse to change a decision that may have
  been made.

      iex> core = Situ.Fusion.Core.new(&{&1, &2}, values: :map)
      iex> message = &%Situ.Message{originating_time: &1, data: &2}
      iex> {outputs, core} = Situ.Fusion.Core.primary(core, [message.(1, :a)])
      iex> outputs
      [{:out, 1, {:a, %{}}}]
      iex> {:ok, 2, core} = Situ.Fusion.Core.add(core, :s0, "ann", Situ.Reproducible.exact(), from: 2)
      iex> {[], core} = Situ.Fusion.Core.primary(core, [message.(2, :b)])
      iex> {outputs, _core} = Situ.Fusion.Core.secondary(core, :s0, [message.(2, :x)])
      iex> outputs
      [{:out, 2, {:b, %{"ann" => :x}}}]
  """
  alias Situ.{Component, Error, Interpolator, Message}
  alias Situ.Fusion.{Decision, Keys, Member, MessageQueue, Secondary, Span}

  @enforce_keys [:creator, :values]
  defstruct [
    :creator,
    :values,
    :give_up_after,
    :max_queue,
    :arrived,
    :waiting,
    ended: :stay,
    members: [],
    queue: MessageQueue.new(),
    closed: false,
    given_up: 0,
    dropped: 0
  ]

  @type input :: atom()
  @type t :: %__MODULE__{
          creator: (term(), term() -> term()),
          values: :one | :list | :map,
          give_up_after: Situ.Time.duration() | nil,
          max_queue: pos_integer() | nil,
          arrived: Message.t() | nil,
          waiting: {input(), Situ.Time.t() | :infinity | nil} | nil,
          ended: :stay | :leave,
          members: [Member.t()],
          queue: MessageQueue.t(),
          closed: boolean(),
          given_up: non_neg_integer(),
          dropped: non_neg_integer()
        }

  @doc """
  A fusion whose outputs are `creator.(primary, values)`.

    * `members:` `{input, key, interpolator, span}` of each secondary, the span as options of `add/5`
    * `values:` `:one` (the only secondary's value), `:list` or `:map` (by key)
    * `give_up_after:` ns: a primary that still waits when a primary this much later has arrived is decided by the
      messages that are there. It bounds memory when a secondary falls silent, and makes the result depend on
      timing.
    * `max_queue:` the same by count: so many primaries wait at most, and so many messages of each secondary
    * `ended: :leave`: a member whose stream has ended is not needed after that time
  """
  @spec new((term(), term() -> term()), keyword()) :: t()
  def new(creator, opts) do
    {members, opts} = Keyword.pop(opts, :members, [])
    Enum.reduce(members, struct!(__MODULE__, [creator: creator] ++ opts), &member/2)
  end

  defp member({input, key, interpolator, span}, core) do
    {:ok, _from, core} = add(core, input, key, interpolator, span)
    core
  end

  @doc """
  A member from now on. `from:` is the first time that needs it: by default, and at the earliest, behind the last
  primary that has arrived and behind `after:`, the last of its messages that will not come. Answers the time, or
  `:start` when nothing has been yet. `until:` as `remove/3` would set it.
  """
  @spec add(t(), input(), term(), Interpolator.t(), keyword()) ::
          {:ok, Situ.Time.t() | :start, t()} | {:error, Error.t()}
  def add(core, input, key, interpolator, opts) do
    earlier = for %{key: ^key, until: until} <- core.members, until != nil, do: until - 1
    earliest = Span.behind([arrived(core), opts[:after] | earlier])

    with :ok <- Keys.free(keys(core), key),
         {:ok, from} <- Span.possible(opts[:from], earliest, "take part from") do
      span = [from: from, until: opts[:until]]
      member = struct!(%Member{input: input, key: key, interpolator: interpolator}, span)
      {:ok, from || :start, %{core | members: core.members ++ [member]}}
    end
  end

  @doc """
  The member with this key is not needed from `until:` on: by default, and at the earliest, behind the last primary
  that has arrived; `:start` when none has.
  """
  @spec remove(t(), term(), keyword()) ::
          {:ok, Situ.Time.t() | :start, [Component.action()], t()} | {:error, Error.t()}
  def remove(core, key, opts) do
    earliest = Span.behind([arrived(core)])

    with {:ok, member} <- find(core, key),
         {:ok, until} <- Span.possible(opts[:until], earliest, "be left out from") do
      until = until || Span.beginning()
      {outputs, core} = Decision.run(change(core, member, until: until))
      {:ok, if(until == Span.beginning(), do: :start, else: until), outputs, core}
    end
  end

  @doc "Primary messages arrived."
  @spec primary(t(), [Message.t()]) :: {[Component.action()], t()}
  def primary(core, []), do: {[], core}

  def primary(core, messages) do
    arrived = MessageQueue.last(messages)
    core = %{core | queue: MessageQueue.push(core.queue, messages), arrived: arrived}

    # Only where the wait is bounded can a primary decide something about another one.
    if core.waiting == nil or core.give_up_after != nil or core.max_queue != nil,
      do: Decision.run(core),
      else: {[], core}
  end

  @doc "The primary stream ended: primaries that still wait are decided by their secondaries alone."
  @spec close_primary(t()) :: t()
  def close_primary(core), do: %{core | closed: true}

  @doc "Messages of a member arrived; those of one that is gone are passed over."
  @spec secondary(t(), input(), [Message.t()]) :: {[Component.action()], t()}
  def secondary(
        %{members: [%{input: input, from: nil} = member]} = core,
        input,
        [_ | _] = messages
      ) do
    {queue, dropped} = Secondary.push(member.queue, messages, core.max_queue)
    core = %{core | members: [%{member | queue: queue}], dropped: core.dropped + dropped}
    awake(core, input, Secondary.reached(queue))
  end

  def secondary(core, input, messages) do
    with %Member{} = member <- Enum.find(core.members, &(&1.input == input)),
         [_ | _] = messages <- Member.since(messages, member.from) do
      {queue, dropped} = Secondary.push(member.queue, messages, core.max_queue)
      core = change(%{core | dropped: core.dropped + dropped}, member, queue: queue)
      awake(core, input, Secondary.reached(queue))
    else
      _ -> {[], core}
    end
  end

  @doc "A member's stream ended at `time`."
  @spec close(t(), input(), Situ.Time.t()) :: {[Component.action()], t()}
  def close(core, input, time) do
    case Enum.find(core.members, &(&1.input == input)) do
      nil ->
        {[], core}

      member ->
        queue = Secondary.close(member.queue, time)
        until = if core.ended == :leave, do: min(time + 1, member.until), else: member.until
        Decision.run(change(core, member, queue: queue, until: until))
    end
  end

  @doc "Inputs whose members nobody will need any more; they are forgotten."
  @spec gone(t()) :: {[input()], t()}
  def gone(%{values: :map} = core) do
    case Enum.split_with(core.members, &over?(&1, core)) do
      {[], _} -> {[], core}
      {over, kept} -> {Enum.map(over, & &1.input), %{core | members: kept}}
    end
  end

  def gone(core), do: {[], core}

  @doc "The input that a decision waits for, or `:primary`."
  @spec awaited(t()) :: input()
  def awaited(%{waiting: {input, _until}}), do: input
  def awaited(_core), do: :primary

  @doc "The sequence ids of the first messages that wait, per input."
  @spec heads(t()) :: [{input(), non_neg_integer() | nil}]
  def heads(core) do
    secondary =
      for %{input: input, queue: {front, rear, _, _}} <- core.members,
          do: {input, MessageQueue.head({front, rear})}

    [{:primary, MessageQueue.head(core.queue)} | secondary]
  end

  @doc "How many messages wait: of the primary, and of each key."
  @spec queued(t()) :: %{primary: non_neg_integer(), secondary: [{term(), non_neg_integer()}]}
  def queued(core) do
    %{
      primary: MessageQueue.count(core.queue),
      secondary: for(m <- core.members, do: {m.key, MessageQueue.count(Secondary.queue(m.queue))})
    }
  end

  # A waiting primary is looked at again only when the stream that it waits for got far enough.
  defp awake(%{waiting: nil} = core, _input, _last), do: Decision.run(core)
  defp awake(%{waiting: {input, nil}} = core, input, _last), do: Decision.run(core)

  defp awake(%{waiting: {input, until}} = core, input, last) when last >= until,
    do: Decision.run(core)

  defp awake(core, _input, _last), do: {[], core}

  defp arrived(%{arrived: nil}), do: nil
  defp arrived(%{arrived: message}), do: message.originating_time

  # Those that leave have no key any more.
  defp keys(core), do: for(%{until: nil, key: key} <- core.members, do: key)

  defp find(core, key) do
    case Enum.find(core.members, &(&1.key == key and &1.until == nil)) do
      nil -> Keys.unknown(keys(core), key)
      member -> {:ok, member}
    end
  end

  defp change(core, %{input: input}, changes) do
    members = Enum.map(core.members, &if(&1.input == input, do: struct!(&1, changes), else: &1))
    %{core | members: members}
  end

  defp over?(member, core),
    do: Span.over?({member.from, member.until}, arrived(core), core.closed, core.queue)
end
