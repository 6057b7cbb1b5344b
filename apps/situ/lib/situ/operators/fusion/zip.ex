defmodule Situ.Fusion.Zip do
  @moduledoc """
  The pure core of `Situ.zip/2`: groups the messages of several inputs by originating time.

  A group is emitted once every input has reached its time or ended, in time order. Values in a group are in the order
  of the inputs. An input without a message at that time adds nothing.

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

  alias Situ.{Component, Message}
  alias Situ.Fusion.MessageQueue

  # Contains each input's queue and the time it has reached: `:nothing` if the input has not sent a message, and
  # `:closed` if it has ended.
  @enforce_keys [:inputs]
  defstruct [:inputs, frontier: :nothing]

  @type reached :: Situ.Time.t() | :nothing | :closed
  @type t :: %__MODULE__{
          inputs: [{MessageQueue.t(), reached()}],
          frontier: reached()
        }

  @doc "Builds the state for `n` inputs."
  @spec new(pos_integer()) :: t()
  def new(n), do: %__MODULE__{inputs: List.duplicate({MessageQueue.new(), :nothing}, n)}

  @doc "Adds messages of input number `index` (from 0) and returns the groups that are complete."
  @spec push(t(), non_neg_integer(), [Message.t()]) :: {[Component.action()], t()}
  def push(zip, _index, []), do: {[], zip}

  def push(zip, index, messages) do
    %Message{originating_time: last} = MessageQueue.last(messages)

    inputs =
      List.update_at(zip.inputs, index, fn {queue, _} ->
        {MessageQueue.push(queue, messages), last}
      end)

    release(%{zip | inputs: inputs})
  end

  @doc "Marks input number `index` as ended and returns the groups that are complete."
  @spec close(t(), non_neg_integer()) :: {[Component.action()], t()}
  def close(zip, index) do
    release(%{zip | inputs: List.update_at(zip.inputs, index, &put_elem(&1, 1, :closed))})
  end

  @doc "Returns the indices of the inputs that delay the others."
  @spec awaited(t()) :: [non_neg_integer()]
  def awaited(zip) do
    least = frontier(zip.inputs, :closed)
    for {{_, reached}, index} <- Enum.with_index(zip.inputs), reached == least, do: index
  end

  @doc "Returns the sequence id of the first waiting message per input."
  @spec heads(t()) :: [non_neg_integer() | nil]
  def heads(zip), do: for({queue, _} <- zip.inputs, do: MessageQueue.head(queue))

  @doc "Returns the number of waiting messages per input."
  @spec queued(t()) :: [non_neg_integer()]
  def queued(zip), do: for({queue, _} <- zip.inputs, do: MessageQueue.count(queue))

  defp release(%{frontier: frontier} = zip) do
    case frontier(zip.inputs, :closed) do
      ^frontier -> {[], zip}
      :nothing -> {[], zip}
      new -> emit(%{zip | frontier: new})
    end
  end

  defp emit(%{inputs: inputs, frontier: frontier} = zip) do
    {released, kept} = inputs |> Enum.map(&split(&1, frontier)) |> Enum.unzip()
    {group(:lists.reverse(released)), %{zip | inputs: kept}}
  end

  # `:closed` is an atom and so sorts after every time. An input that has not sent a message delays all others.
  defp frontier([], least), do: least
  defp frontier([{_, :nothing} | _], _least), do: :nothing
  defp frontier([{_, reached} | inputs], least), do: frontier(inputs, min(reached, least))

  # An input at the frontier delays the others, so its whole queue can be emitted.
  defp split({queue, reached}, frontier) when frontier == :closed or frontier == reached do
    {released, []} = MessageQueue.whole(queue)
    {released, {MessageQueue.new(), reached}}
  end

  defp split({queue, reached}, frontier) do
    {released, queue} = MessageQueue.take(queue, frontier)
    {released, {queue, reached}}
  end

  # Goes through the inputs from last to first, so that each value can be prepended.
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
