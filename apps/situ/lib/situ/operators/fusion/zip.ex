defmodule Situ.Fusion.Zip do
  @moduledoc """
  The pure heart of `Situ.zip/2`: groups the messages of several inputs by originating time.

  A group goes out once every input has reached its time (or ended), in time order; inside a group values are in the order of
  the inputs, and an input without a message at that time adds nothing.

      iex> zip = Situ.Fusion.Zip.new(2)
      iex> message = &%Situ.Message{originating_time: &1, data: &2}
      iex> {[], zip} = Situ.Fusion.Zip.push(zip, 0, [message.(1, :a), message.(3, :b)])
      iex> {outputs, zip} = Situ.Fusion.Zip.push(zip, 1, [message.(1, :x), message.(2, :y)])
      iex> outputs
      [{:out, 1, [:a, :x]}, {:out, 2, [:y]}]
      iex> {outputs, _zip} = Situ.Fusion.Zip.close(zip, 1)
      iex> outputs
      [{:out, 3, [:b]}]
  """

  alias Situ.Message

  # Per input: the queue (in order), batches that came later (newest first), and the time it has reached. An input
  # that has sent nothing is at `:nothing`, an ended one at `:closed`.
  @enforce_keys [:sides]
  defstruct [:sides, frontier: :nothing]

  @type reached :: Situ.Time.t() | :nothing | :closed
  @type t :: %__MODULE__{
          sides: [{[Message.t()], [[Message.t()]], reached()}],
          frontier: reached()
        }

  @doc "For this many inputs."
  @spec new(pos_integer()) :: t()
  def new(inputs), do: %__MODULE__{sides: List.duplicate({[], [], :nothing}, inputs)}

  @doc "Messages of input number `index` (from 0) arrived."
  @spec push(t(), non_neg_integer(), [Message.t()]) :: {[Situ.Fusion.Core.output()], t()}
  def push(zip, _index, []), do: {[], zip}

  def push(zip, index, messages) do
    %Message{originating_time: last} = List.last(messages)

    sides =
      List.update_at(zip.sides, index, fn
        {[], [], _reached} -> {messages, [], last}
        {front, rear, _reached} -> {front, [messages | rear], last}
      end)

    release(%{zip | sides: sides})
  end

  @doc "Input number `index` ended."
  @spec close(t(), non_neg_integer()) :: {[Situ.Fusion.Core.output()], t()}
  def close(zip, index) do
    release(%{zip | sides: List.update_at(zip.sides, index, &put_elem(&1, 2, :closed))})
  end

  @doc "Indices of the inputs that hold the others back."
  @spec awaited(t()) :: [non_neg_integer()]
  def awaited(zip) do
    least = frontier(zip.sides, :closed)
    for {{_, _, reached}, index} <- Enum.with_index(zip.sides), reached == least, do: index
  end

  @doc "The sequence ids of the first messages that wait, per input."
  @spec heads(t()) :: [non_neg_integer() | nil]
  def heads(zip), do: for({front, rear, _} <- zip.sides, do: head(front, rear))

  defp head([%{sequence_id: id} | _], _rear), do: id
  defp head([], []), do: nil
  defp head([], rear), do: rear |> List.last() |> hd() |> Map.fetch!(:sequence_id)

  @doc "How many messages wait, per input."
  @spec queued(t()) :: [non_neg_integer()]
  def queued(zip) do
    for {front, rear, _} <- zip.sides,
        do: length(front) + Enum.reduce(rear, 0, &(length(&1) + &2))
  end

  defp release(%{frontier: frontier} = zip) do
    case frontier(zip.sides, :closed) do
      ^frontier -> {[], zip}
      :nothing -> {[], zip}
      new -> emit(%{zip | frontier: new})
    end
  end

  defp emit(%{sides: sides, frontier: frontier} = zip) do
    {released, kept} = sides |> Enum.map(&split(&1, frontier)) |> Enum.unzip()
    {group(:lists.reverse(released)), %{zip | sides: kept}}
  end

  # `:closed`, an atom, sorts after every time; an input that has sent nothing holds everything back.
  defp frontier([], least), do: least
  defp frontier([{_, _, :nothing} | _], _least), do: :nothing
  defp frontier([{_, _, reached} | sides], least), do: frontier(sides, min(reached, least))

  defp split({front, rear, reached}, :closed), do: {merge(front, rear), {[], [], reached}}

  # This input is the one that holds the others back: all of it goes out.
  defp split({front, rear, reached}, reached), do: {merge(front, rear), {[], [], reached}}

  # What came later is looked at only when all of the queue goes out: an input that is far ahead costs nothing.
  defp split({front, rear, reached}, frontier) do
    case take(front, frontier, []) do
      {released, []} when rear != [] ->
        {more, kept} = take(merge([], rear), frontier, [])
        {released ++ more, {kept, [], reached}}

      {released, kept} ->
        {released, {kept, rear, reached}}
    end
  end

  defp take([%{originating_time: time} = message | rest], frontier, taken) when time <= frontier,
    do: take(rest, frontier, [message | taken])

  defp take(rest, _frontier, taken), do: {:lists.reverse(taken), rest}

  defp merge(front, []), do: front
  defp merge(front, rear), do: front ++ :lists.append(:lists.reverse(rear))

  # Inputs from the last to the first, so that each one's value is put in front.
  defp group([last | others]) do
    groups = for %{originating_time: time, data: data} <- last, do: {:out, time, [data]}
    Enum.reduce(others, groups, &weave(&1, &2))
  end

  defp weave([], groups), do: groups
  defp weave(messages, []), do: for(m <- messages, do: {:out, m.originating_time, [m.data]})

  defp weave([%{originating_time: time} = message | messages], [{:out, at, values} | groups])
       when time == at,
       do: [{:out, at, [message.data | values]} | weave(messages, groups)]

  defp weave([%{originating_time: time} = message | messages], [{:out, at, _} | _] = groups)
       when time < at,
       do: [{:out, time, [message.data]} | weave(messages, groups)]

  defp weave(messages, [group | groups]), do: [group | weave(messages, groups)]
end
