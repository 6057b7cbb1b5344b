defmodule Situ.Fusion.Zip do
  @moduledoc false
  # The pure core of `Situ.zip/3`: groups the messages of several inputs by originating time.
  #
  # A group is emitted once every input has reached its time or ended, in time order. Values in a group are in the
  # order of the inputs. An input without a message at that time adds nothing.
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

  @doc """
  Adds messages of input number `index` (from 0) and returns the groups that are complete.

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
  @spec push(t(), non_neg_integer(), [Message.t()]) :: {[Component.action()], t()}
  def push(zip, _index, []), do: {[], zip}

  def push(zip, index, messages) do
    %Message{originating_time: last} = MessageQueue.last_message(messages)

    inputs =
      List.update_at(zip.inputs, index, fn {queue, _} ->
        {MessageQueue.push(queue, messages), last}
      end)

    release_groups(%{zip | inputs: inputs})
  end

  @doc "Marks input number `index` as ended and returns the groups that are complete."
  @spec close(t(), non_neg_integer()) :: {[Component.action()], t()}
  def close(zip, index) do
    release_groups(%{zip | inputs: List.update_at(zip.inputs, index, &put_elem(&1, 1, :closed))})
  end

  @doc "Marks all inputs as open again."
  @spec reopen(t()) :: t()
  def reopen(zip), do: %{zip | inputs: Enum.map(zip.inputs, &put_elem(&1, 1, :nothing))}

  @doc "Returns the indices of the inputs that delay the others."
  @spec awaited_indices(t()) :: [non_neg_integer()]
  def awaited_indices(zip) do
    least = lowest_frontier(zip.inputs, :closed)
    for {{_, reached}, index} <- Enum.with_index(zip.inputs), reached == least, do: index
  end

  @doc "Returns the sequence id of the first waiting message per input."
  @spec head_ids(t()) :: [non_neg_integer() | nil]
  def head_ids(zip), do: for({queue, _} <- zip.inputs, do: MessageQueue.head_id(queue))

  @doc "Returns the number of waiting messages per input."
  @spec queue_lengths(t()) :: [non_neg_integer()]
  def queue_lengths(zip), do: for({queue, _} <- zip.inputs, do: MessageQueue.message_count(queue))

  defp release_groups(%{frontier: frontier} = zip) do
    case lowest_frontier(zip.inputs, :closed) do
      ^frontier -> {[], zip}
      :nothing -> {[], zip}
      new -> emit_groups(%{zip | frontier: new})
    end
  end

  defp emit_groups(%{inputs: inputs, frontier: frontier} = zip) do
    {released, remaining} = inputs |> Enum.map(&split_queue(&1, frontier)) |> Enum.unzip()
    {group_by_time(:lists.reverse(released)), %{zip | inputs: remaining}}
  end

  # `:closed` is an atom and so sorts after every time. An input that has not sent a message delays all others.
  defp lowest_frontier([], least), do: least
  defp lowest_frontier([{_, :nothing} | _], _least), do: :nothing

  defp lowest_frontier([{_, reached} | inputs], least),
    do: lowest_frontier(inputs, min(reached, least))

  # An input at the frontier delays the others, so its whole queue can be emitted.
  defp split_queue({queue, reached}, frontier) when frontier == :closed or frontier == reached do
    {released, []} = MessageQueue.merge_batches(queue)
    {released, {MessageQueue.new(), reached}}
  end

  defp split_queue({queue, reached}, frontier) do
    {released, queue} = MessageQueue.take_until(queue, frontier)
    {released, {queue, reached}}
  end

  # Goes through the inputs from last to first, so that each value can be prepended.
  defp group_by_time([last | others]) do
    groups = for %{originating_time: time, data: data} <- last, do: {:out, time, [data]}
    Enum.reduce(others, groups, &merge_into_groups(&1, &2))
  end

  defp merge_into_groups([], groups), do: groups

  defp merge_into_groups(messages, []),
    do: for(m <- messages, do: {:out, m.originating_time, [m.data]})

  defp merge_into_groups([%{originating_time: time} = message | messages], [
         {:out, at, values} | groups
       ])
       when time == at,
       do: [{:out, at, [message.data | values]} | merge_into_groups(messages, groups)]

  defp merge_into_groups(
         [%{originating_time: time} = message | messages],
         [{:out, at, _} | _] = groups
       )
       when time < at,
       do: [{:out, time, [message.data]} | merge_into_groups(messages, groups)]

  defp merge_into_groups(messages, [group | groups]),
    do: [group | merge_into_groups(messages, groups)]
end
