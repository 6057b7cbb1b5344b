defmodule Situ.Fusion.Members do
  @moduledoc """
  The pure heart of a fusion whose secondary streams have keys and may come and go: as `Situ.Fusion.Core`, but each secondary takes part
  for a span of originating times.

  A primary at time t needs a value of every member with `from <= t < until`, no other; of a member's messages those before `from` are
  as if they had never been. So the outputs depend on the spans alone, and not on when a member was added or removed, as long as
  no primary of the span had arrived before: `add/5` and `remove/3` refuse to change what may have been decided already.

      iex> members = Situ.Fusion.Members.new(&{&1, &2})
      iex> message = &%Situ.Message{originating_time: &1, data: &2}
      iex> {outputs, members} = Situ.Fusion.Members.primary(members, [message.(1, :a)])
      iex> outputs
      [{:out, 1, {:a, %{}}}]
      iex> {:ok, 2, members} = Situ.Fusion.Members.add(members, :s0, "ann", Situ.Reproducible.exact(), from: 2)
      iex> {[], members} = Situ.Fusion.Members.primary(members, [message.(2, :b)])
      iex> {outputs, _members} = Situ.Fusion.Members.secondary(members, :s0, [message.(2, :x)])
      iex> outputs
      [{:out, 2, {:b, %{"ann" => :x}}}]
  """
  alias Situ.{Error, Interpolator, Message}
  alias Situ.Fusion.{Core, Keys, Side, Span}

  defmodule Member do
    @moduledoc false
    # `from`: the first time that needs it; `until`: the first that no longer does.
    @enforce_keys [:input, :key, :interpolator]
    defstruct [:input, :key, :interpolator, :from, :until, side: Side.new()]
  end

  @enforce_keys [:creator]
  defstruct [
    :creator,
    :give_up_after,
    :arrived,
    :waiting,
    ended: :stay,
    members: [],
    front: [],
    rear: [],
    closed: false,
    given_up: 0
  ]

  @type input :: atom()
  @type t :: %__MODULE__{}

  @doc """
  Without members. `give_up_after:` as in `Situ.Fusion.Core`; `ended: :leave`: a member whose stream has ended is not needed after that time.
  """
  @spec new((term(), map() -> term()), keyword()) :: t()
  def new(creator, opts \\ []),
    do: struct!(__MODULE__, [creator: creator] ++ Keyword.take(opts, [:give_up_after, :ended]))

  @doc """
  A member from now on. `from:` is the first time that needs it: by default, and at the earliest, behind the last primary that has
  arrived and behind `after:`, the last of its messages that will not come. Answers the time, or `:start` when nothing has been yet.
  `until:` as `remove/3` would set it.
  """
  @spec add(t(), input(), term(), Interpolator.t(), keyword()) ::
          {:ok, Situ.Time.t() | :start, t()} | {:error, Error.t()}
  def add(members, input, key, interpolator, opts) do
    earlier = for %{key: ^key, until: until} <- members.members, until != nil, do: until - 1
    earliest = Span.behind([members.arrived, opts[:after] | earlier])

    with :ok <- Keys.free(keys(members), key),
         {:ok, from} <- Span.possible(opts[:from], earliest, "take part from") do
      span = [from: from, until: opts[:until]]
      member = struct!(%Member{input: input, key: key, interpolator: interpolator}, span)
      {:ok, from || :start, %{members | members: members.members ++ [member]}}
    end
  end

  @doc """
  The member with this key is not needed from `until:` on: by default, and at the earliest, behind the last primary that has arrived; `:start` when
  none has.
  """
  @spec remove(t(), term(), keyword()) ::
          {:ok, Situ.Time.t() | :start, [Core.output()], t()} | {:error, Error.t()}
  def remove(members, key, opts) do
    with {:ok, member} <- find(members, key),
         {:ok, until} <-
           Span.possible(opts[:until], Span.behind([members.arrived]), "be left out from") do
      until = until || Span.beginning()
      {outputs, members} = run(%{change(members, member, until: until) | waiting: nil})
      {:ok, if(until == Span.beginning(), do: :start, else: until), outputs, members}
    end
  end

  @doc "Primary messages arrived."
  @spec primary(t(), [Message.t(), ...]) :: {[Core.output()], t()}
  def primary(members, messages) do
    members = %{members | rear: [messages | members.rear], arrived: Side.last_time(messages)}
    # Only with `give_up_after:` can a primary decide something about another one.
    if members.waiting == nil or members.give_up_after != nil,
      do: run(%{members | waiting: nil}),
      else: {[], members}
  end

  @doc "The primary stream ended."
  @spec close_primary(t()) :: t()
  def close_primary(members), do: %{members | closed: true}

  @doc "Messages of a member arrived; those of one that is gone are passed over."
  @spec secondary(t(), input(), [Message.t(), ...]) :: {[Core.output()], t()}
  def secondary(members, input, messages) do
    with %Member{} = member <- member(members, input),
         [_ | _] = messages <- since(messages, member.from) do
      pushed(members, member, Side.push(member.side, messages))
    else
      _ -> {[], members}
    end
  end

  @doc "A member's stream ended at `time`."
  @spec close(t(), input(), Situ.Time.t()) :: {[Core.output()], t()}
  def close(members, input, time) do
    case member(members, input) do
      nil ->
        {[], members}

      member ->
        side = Side.close(member.side, time)
        until = if members.ended == :leave, do: min(time + 1, member.until), else: member.until
        run(%{change(members, member, side: side, until: until) | waiting: nil})
    end
  end

  @doc "Inputs whose members nobody will need any more; they are forgotten."
  @spec gone(t()) :: {[input()], t()}
  def gone(members) do
    case Enum.split_with(members.members, &over?(&1, members)) do
      {[], _} -> {[], members}
      {over, kept} -> {Enum.map(over, & &1.input), %{members | members: kept}}
    end
  end

  @doc "The input that a decision waits for, or `:primary`."
  @spec awaited(t()) :: input()
  def awaited(%{waiting: {input, _until}}), do: input
  def awaited(_members), do: :primary

  @doc "The sequence ids of the first messages that wait, per input."
  @spec heads(t()) :: [{input(), non_neg_integer() | nil}]
  def heads(members) do
    secondary = for member <- members.members, do: {member.input, Side.head(member.side)}
    [{:primary, Side.first(members.front, members.rear)} | secondary]
  end

  @doc "What waits: of the primary, and of each key."
  @spec queued(t()) :: %{
          primary: non_neg_integer(),
          secondary: %{term() => non_neg_integer()},
          given_up: non_neg_integer()
        }
  def queued(members) do
    %{
      primary: Side.count(members.front, members.rear),
      secondary: Map.new(members.members, &{&1.key, Side.count(&1.side)}),
      given_up: members.given_up
    }
  end

  # Those that leave have no key any more.
  defp keys(members), do: for(%{until: nil, key: key} <- members.members, do: key)

  defp find(members, key) do
    case Enum.find(members.members, &(&1.key == key and &1.until == nil)) do
      nil -> Keys.unknown(keys(members), key)
      member -> {:ok, member}
    end
  end

  defp member(members, input), do: Enum.find(members.members, &(&1.input == input))

  defp change(members, %{input: input}, changes) do
    changed =
      Enum.map(members.members, &if(&1.input == input, do: struct!(&1, changes), else: &1))

    %{members | members: changed}
  end

  defp since(messages, nil), do: messages

  defp since([%{originating_time: time} | rest], from) when time < from, do: since(rest, from)
  defp since(messages, _from), do: messages

  defp over?(member, members) do
    waiting = {members.front, members.rear}
    Span.over?({member.from, member.until}, members.arrived, members.closed, waiting)
  end

  # Deciding

  defp pushed(members, member, side) do
    members = change(members, member, side: side)
    {input, last} = {member.input, Side.reached(side)}

    case members.waiting do
      {^input, nil} -> run(%{members | waiting: nil})
      {^input, until} when last >= until -> run(%{members | waiting: nil})
      nil -> run(members)
      _waits_for_another -> {[], members}
    end
  end

  defp run(members), do: run(members, [])

  defp run(%{front: [], rear: []} = members, outputs), do: {:lists.reverse(outputs), members}

  defp run(%{front: [], rear: rear} = members, outputs),
    do: run(%{members | front: Side.merge([], rear), rear: []}, outputs)

  defp run(%{front: [primary | rest]} = members, outputs) do
    time = primary.originating_time

    case ask(members.members, time, limit(members), %{}, []) do
      {:all, values, asked} ->
        output = {:out, time, members.creator.(primary.data, values)}
        run(%{members | front: rest, members: asked}, [output | outputs])

      {:none, asked} ->
        run(%{members | front: rest, members: asked}, outputs)

      {:given_up, asked} ->
        run(%{members | front: rest, members: asked, given_up: members.given_up + 1}, outputs)

      # The same primary is asked for again: its secondaries must be as they were.
      {:wait, waiting} ->
        {:lists.reverse(outputs), %{members | waiting: waiting}}
    end
  end

  defp limit(%{give_up_after: nil}), do: nil
  defp limit(%{arrived: nil}), do: nil
  defp limit(members), do: members.arrived - members.give_up_after

  defp ask([], _time, _limit, values, done), do: {:all, values, :lists.reverse(done)}

  defp ask([%{from: from} = member | rest], time, limit, values, done)
       when from != nil and time < from,
       do: ask(rest, time, limit, values, [member | done])

  # `nil`, an atom, sorts after every time.
  defp ask([%{until: until} = member | rest], time, limit, values, done) when time >= until,
    do: ask(rest, time, limit, values, [member | done])

  defp ask([member | rest], time, limit, values, done) do
    case Side.ask(member.interpolator, time, member.side, limit) do
      {:created, value, side} ->
        values = Map.put(values, member.key, value)
        ask(rest, time, limit, values, [%{member | side: side} | done])

      {:does_not_exist, side} ->
        {:none, :lists.reverse(done, [%{member | side: side} | rest])}

      {:given_up, side} ->
        {:given_up, :lists.reverse(done, [%{member | side: side} | rest])}

      {:wait, until, _side} ->
        {:wait, {member.input, until}}
    end
  end
end
