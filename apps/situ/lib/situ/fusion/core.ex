defmodule Situ.Fusion.Core do
  @moduledoc false
  # The pure core of fusion: a queue of primary messages, a queue per secondary stream, and the rule that pairs them.
  #
  # Each arrival tries to complete the oldest primary, by asking each secondary's interpolator for a value at its
  # time.
  #
  #   * If all secondaries have a value, there is an output at the primary's originating time.
  #   * If one is undecided, the primary and all later ones wait, so outputs keep the order of the primaries.
  #   * If one has no value, the primary is dropped.
  #
  # Secondary messages that no later primary can need are dropped immediately, so memory is bounded by the undecided
  # messages.
  #
  # Secondaries can be added and removed. Each takes part for a span of originating times: a primary at time t needs a
  # value from each member with `from <= t < until`, and from no other. A member's messages before `from` are ignored.
  # So the outputs depend only on the spans, and not on when a member was added or removed, as long as no primary of
  # the span had arrived by then. `add_member/5` and `remove_member/3` reject changes to decisions that may already
  # have been made.
  alias Situ.{Component, Error, Interpolator, Message}
  alias Situ.Fusion.{Decision, InputKeys, Member, MessageQueue, SecondaryQueue, Span}

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
  Builds a fusion whose outputs are `creator.(primary, values)`.

    * `members:` `{input, key, interpolator, span}` for each secondary, with the span as options of `add_member/5`
    * `values:` `:one` (the only secondary's value), `:list` or `:map` (by key)
    * `give_up_after:` maximum wait, ns. When a primary this much later has arrived, a waiting primary is decided using
      the messages that have arrived. This bounds memory when a secondary falls silent, and makes the result depend on
      timing.
    * `max_queue:` the maximum number of waiting primaries, and of waiting messages of each secondary
    * `ended: :leave`: a member whose stream has ended is not needed after that time
  """
  @spec new((term(), term() -> term()), keyword()) :: t()
  def new(creator, opts) do
    {members, opts} = Keyword.pop(opts, :members, [])
    Enum.reduce(members, struct!(__MODULE__, [creator: creator] ++ opts), &add_initial_member/2)
  end

  defp add_initial_member({input, key, interpolator, span}, core) do
    {:ok, _from, core} = add_member(core, input, key, interpolator, span)
    core
  end

  @doc """
  Adds a member. `from:` is the first time that needs it. The default, and the earliest time allowed, is after the last
  primary that has arrived and after `after:`, the last message of the member that was missed. Returns that time, or
  `:start` if nothing has arrived yet. `until:` has the same meaning as in `remove_member/3`.

      iex> core = Situ.Fusion.Core.new(&{&1, &2}, values: :map)
      iex> message = &%Situ.Message{originating_time: &1, data: &2}
      iex> {outputs, core} = Situ.Fusion.Core.push_primary(core, [message.(1, :a)])
      iex> outputs
      [{:out, 1, {:a, %{}}}]
      iex> {:ok, 2, core} = Situ.Fusion.Core.add_member(core, :s0, "ann", Situ.Reproducible.exact(), from: 2)
      iex> {[], core} = Situ.Fusion.Core.push_primary(core, [message.(2, :b)])
      iex> {outputs, _core} = Situ.Fusion.Core.push_secondary(core, :s0, [message.(2, :x)])
      iex> outputs
      [{:out, 2, {:b, %{"ann" => :x}}}]
  """
  @spec add_member(t(), input(), term(), Interpolator.t(), keyword()) ::
          {:ok, Situ.Time.t() | :start, t()} | {:error, Error.t()}
  def add_member(core, input, key, interpolator, opts) do
    earlier = for %{key: ^key, until: until} <- core.members, until != nil, do: until - 1
    earliest = Span.first_time_after([last_arrival_time(core), opts[:after] | earlier])

    with :ok <- InputKeys.check_free(active_keys(core), key),
         {:ok, from} <- Span.validate_time(opts[:from], earliest, "take part from") do
      span = [from: from, until: opts[:until]]
      member = struct!(%Member{input: input, key: key, interpolator: interpolator}, span)
      {:ok, from || :start, %{core | members: core.members ++ [member]}}
    end
  end

  @doc """
  Removes the member with this key. It is not needed from `until:` on. The default, and the earliest time allowed, is
  after the last primary that has arrived. Returns `:start` if no primary has arrived yet.
  """
  @spec remove_member(t(), term(), keyword()) ::
          {:ok, Situ.Time.t() | :start, [Component.action()], t()} | {:error, Error.t()}
  def remove_member(core, key, opts) do
    earliest = Span.first_time_after([last_arrival_time(core)])

    with {:ok, member} <- fetch_member(core, key),
         {:ok, until} <- Span.validate_time(opts[:until], earliest, "be left out from") do
      until = until || Span.before_all_times()
      {outputs, core} = Decision.decide_waiting(update_member(core, member, until: until))
      {:ok, if(until == Span.before_all_times(), do: :start, else: until), outputs, core}
    end
  end

  @doc """
  Adds primary messages and returns the outputs they cause.

      iex> core = Situ.Fusion.Core.new(&{&1, &2}, members: [{:s0, 0, Situ.Reproducible.exact(), []}], values: :one)
      iex> message = &%Situ.Message{originating_time: &1, data: &2}
      iex> {[], core} = Situ.Fusion.Core.push_primary(core, [message.(1, :a), message.(2, :b)])
      iex> {outputs, _core} = Situ.Fusion.Core.push_secondary(core, :s0, [message.(2, :x)])
      iex> outputs
      [{:out, 2, {:b, :x}}]
  """
  @spec push_primary(t(), [Message.t()]) :: {[Component.action()], t()}
  def push_primary(core, []), do: {[], core}

  def push_primary(core, messages) do
    arrived = MessageQueue.last_message(messages)
    core = %{core | queue: MessageQueue.push(core.queue, messages), arrived: arrived}

    # A new primary can end the wait of an earlier one only if the wait is bounded.
    if core.waiting == nil or core.give_up_after != nil or core.max_queue != nil,
      do: Decision.decide_waiting(core),
      else: {[], core}
  end

  @doc "Marks the primary stream as ended. Waiting primaries are then decided by their secondaries alone."
  @spec close_primary(t()) :: t()
  def close_primary(core), do: %{core | closed: true}

  @doc "Marks all streams as open again."
  @spec reopen(t()) :: t()
  def reopen(core) do
    members =
      for member <- core.members, do: %{member | queue: SecondaryQueue.reopen(member.queue)}

    %{core | closed: false, members: members}
  end

  @doc "Adds messages of a member and returns the outputs they cause. Messages of removed members are ignored."
  @spec push_secondary(t(), input(), [Message.t()]) :: {[Component.action()], t()}
  def push_secondary(
        %{members: [%{input: input, from: nil} = member]} = core,
        input,
        [_ | _] = messages
      ) do
    {queue, dropped} = SecondaryQueue.push(member.queue, messages, core.max_queue)
    core = %{core | members: [%{member | queue: queue}], dropped: core.dropped + dropped}
    decide_if_reached(core, input, SecondaryQueue.reached_time(queue))
  end

  def push_secondary(core, input, messages) do
    with %Member{} = member <- Enum.find(core.members, &(&1.input == input)),
         [_ | _] = messages <- Member.messages_since(messages, member.from) do
      {queue, dropped} = SecondaryQueue.push(member.queue, messages, core.max_queue)
      core = update_member(%{core | dropped: core.dropped + dropped}, member, queue: queue)
      decide_if_reached(core, input, SecondaryQueue.reached_time(queue))
    else
      _ -> {[], core}
    end
  end

  @doc "Marks a member's stream as ended at `time`."
  @spec close_secondary(t(), input(), Situ.Time.t()) :: {[Component.action()], t()}
  def close_secondary(core, input, time) do
    case Enum.find(core.members, &(&1.input == input)) do
      nil ->
        {[], core}

      member ->
        queue = SecondaryQueue.close(member.queue, time)
        until = if core.ended == :leave, do: min(time + 1, member.until), else: member.until
        Decision.decide_waiting(update_member(core, member, queue: queue, until: until))
    end
  end

  @doc "Removes the members that no primary can need any more, and returns their inputs."
  @spec take_finished_inputs(t()) :: {[input()], t()}
  def take_finished_inputs(%{values: :map} = core) do
    case Enum.split_with(core.members, &member_finished?(&1, core)) do
      {[], _} -> {[], core}
      {finished, remaining} -> {Enum.map(finished, & &1.input), %{core | members: remaining}}
    end
  end

  def take_finished_inputs(core), do: {[], core}

  @doc "Returns the input that the next decision is waiting for, or `:primary`."
  @spec awaited_input(t()) :: input()
  def awaited_input(%{waiting: {input, _until}}), do: input
  def awaited_input(_core), do: :primary

  @doc "Returns the sequence id of the first waiting message per input."
  @spec head_ids(t()) :: [{input(), non_neg_integer() | nil}]
  def head_ids(core) do
    secondary =
      for %{input: input, queue: {front, rear, _, _}} <- core.members,
          do: {input, MessageQueue.head_id({front, rear})}

    [{:primary, MessageQueue.head_id(core.queue)} | secondary]
  end

  @doc "Returns the number of waiting primaries, and of waiting messages per key."
  @spec queue_lengths(t()) :: %{
          primary: non_neg_integer(),
          secondary: [{term(), non_neg_integer()}]
        }
  def queue_lengths(core) do
    %{
      primary: MessageQueue.message_count(core.queue),
      secondary:
        for(
          m <- core.members,
          do: {m.key, MessageQueue.message_count(SecondaryQueue.message_queue(m.queue))}
        )
    }
  end

  # A waiting primary is only reconsidered when the stream it is waiting for has advanced far enough.
  defp decide_if_reached(%{waiting: nil} = core, _input, _last), do: Decision.decide_waiting(core)

  defp decide_if_reached(%{waiting: {input, nil}} = core, input, _last),
    do: Decision.decide_waiting(core)

  defp decide_if_reached(%{waiting: {input, until}} = core, input, last) when last >= until,
    do: Decision.decide_waiting(core)

  defp decide_if_reached(core, _input, _last), do: {[], core}

  defp last_arrival_time(%{arrived: nil}), do: nil
  defp last_arrival_time(%{arrived: message}), do: message.originating_time

  # Members that have an end no longer occupy their key.
  defp active_keys(core), do: for(%{until: nil, key: key} <- core.members, do: key)

  defp fetch_member(core, key) do
    case Enum.find(core.members, &(&1.key == key and &1.until == nil)) do
      nil -> InputKeys.unknown_key_error(active_keys(core), key)
      member -> {:ok, member}
    end
  end

  defp update_member(core, %{input: input}, changes) do
    members = Enum.map(core.members, &if(&1.input == input, do: struct!(&1, changes), else: &1))
    %{core | members: members}
  end

  defp member_finished?(member, core),
    do:
      Span.no_longer_needed?(
        {member.from, member.until},
        last_arrival_time(core),
        core.closed,
        core.queue
      )
end
