defmodule Situ.Ports.Inputs do
  @moduledoc false
  # The inputs of a stage by tag: selects the next message and collects the demand for the producers.
  alias Situ.Ports.Input

  # From so many on, they are kept in the order of their heads: fewer are looked through quicker.
  @many 17

  @compile {:inline, touch: 2, publish_counts: 3}

  defstruct by_tag: %{}, tags: [], touched: [], order: nil, closed: [], told: [], in_progress: %{}

  @typedoc """
  `tags` are the keys of `by_tag`; traversing a list is cheaper, and most stages have one input. `touched` lists the
  inputs that have changed since the last settling, so that a message does not visit each of thousands of inputs.
  `order` is used for many inputs: the times of their heads in order, and by tag. `closed` holds the names of closed
  inputs; `told` the inputs whose end the component knew before it was restarted. `in_progress` holds, by tag, how many
  of the last messages the component still works on, and the time of the last finished message.
  """
  @type t :: %__MODULE__{
          by_tag: %{term() => Input.t()},
          tags: [term()],
          touched: [term()],
          order: {:gb_sets.set({Situ.Time.t(), term()}), %{term() => Situ.Time.t()}} | nil,
          closed: [atom()],
          told: [atom()],
          in_progress: %{term() => {pos_integer(), Situ.Time.t() | nil}}
        }

  @spec new([Input.t()]) :: t()
  def new(inputs), do: Enum.reduce(inputs, %__MODULE__{}, &put(&2, &1))

  @doc "Adds or replaces an input."
  @spec put(t(), Input.t()) :: t()
  def put(%__MODULE__{by_tag: by_tag, order: nil} = inputs, %Input{tag: tag} = input) do
    case by_tag do
      %{^tag => _} -> touch(%{inputs | by_tag: %{by_tag | tag => input}}, tag)
      _ -> inputs |> add(input) |> touch(tag)
    end
  end

  def put(%__MODULE__{by_tag: by_tag} = inputs, %Input{tag: tag} = input) do
    inputs = if is_map_key(by_tag, tag), do: inputs, else: add(inputs, input)
    order = order(inputs.order, tag, Input.head_time(input))
    touch(%{inputs | by_tag: %{inputs.by_tag | tag => input}, order: order}, tag)
  end

  defp add(%{by_tag: by_tag} = inputs, %{tag: tag} = input) do
    inputs = %{inputs | by_tag: Map.put(by_tag, tag, input), tags: [tag | inputs.tags]}

    if inputs.order == nil and map_size(inputs.by_tag) >= @many,
      do: %{inputs | order: Enum.reduce(inputs.by_tag, {:gb_sets.new(), %{}}, &order/2)},
      else: inputs
  end

  defp touch(%{touched: [tag | _]} = inputs, tag), do: inputs

  defp touch(%{touched: touched} = inputs, tag),
    do: if(:lists.member(tag, touched), do: inputs, else: %{inputs | touched: [tag | touched]})

  defp order({tag, input}, order), do: order(order, tag, Input.head_time(input))

  defp order({sorted, heads} = order, tag, time) do
    case heads do
      %{^tag => ^time} -> order
      %{^tag => before} -> ordered(:gb_sets.del_element({before, tag}, sorted), heads, tag, time)
      _ -> ordered(sorted, heads, tag, time)
    end
  end

  defp ordered(sorted, heads, tag, :none), do: {sorted, Map.delete(heads, tag)}

  defp ordered(sorted, heads, tag, time),
    do: {:gb_sets.add_element({time, tag}, sorted), Map.put(heads, tag, time)}

  @spec delete(t(), term()) :: t()
  def delete(%__MODULE__{} = inputs, tag) do
    by_tag = Map.delete(inputs.by_tag, tag)
    order = inputs.order && order(inputs.order, tag, :none)
    in_progress = Map.delete(inputs.in_progress, tag)
    %{inputs | by_tag: by_tag, tags: Map.keys(by_tag), order: order, in_progress: in_progress}
  end

  @doc "Sets the function that decides which messages the input `tag` never drops."
  @spec put_guarantee(t(), term(), (term() -> boolean())) :: t()
  def put_guarantee(%__MODULE__{} = inputs, tag, keep?) do
    case inputs.by_tag do
      %{^tag => input} -> put(inputs, Input.put_guarantee(input, keep?))
      _ -> inputs
    end
  end

  @doc "Closes an input; returns whether the component was notified before it was restarted."
  @spec close_input(t(), atom(), term()) :: {boolean(), t()}
  def close_input(%__MODULE__{told: told} = inputs, name, tag) do
    inputs = delete(inputs, tag)
    {name in told, %{inputs | closed: [name | inputs.closed], told: told -- [name]}}
  end

  @doc "Returns the names of the closed inputs."
  @spec closed_names(t()) :: [atom()]
  def closed_names(%__MODULE__{closed: closed}), do: Enum.uniq(closed)

  @doc "Restores the inputs whose end the component knew before it was restarted."
  @spec restore_reported(t(), [atom()]) :: t()
  def restore_reported(%__MODULE__{} = inputs, told), do: %{inputs | told: told}

  @doc "Returns the only input of a chain."
  @spec single_input(t()) :: Input.t() | nil
  def single_input(%__MODULE__{tags: [tag], by_tag: by_tag}), do: :erlang.map_get(tag, by_tag)
  def single_input(%__MODULE__{tags: []}), do: nil

  @spec find_by_name(t(), atom()) :: Input.t() | nil
  def find_by_name(%__MODULE__{by_tag: by_tag}, name),
    do: Enum.find_value(by_tag, fn {_, input} -> if input.name == name, do: input end)

  @doc "Returns the input with the oldest head."
  @spec earliest_input(t()) :: Input.t() | nil
  def earliest_input(%__MODULE__{tags: [tag], by_tag: by_tag}) do
    input = :erlang.map_get(tag, by_tag)
    if Input.has_entry?(input), do: input
  end

  def earliest_input(%__MODULE__{order: nil, tags: tags, by_tag: by_tag}),
    do: earliest(tags, by_tag, nil, nil)

  def earliest_input(%__MODULE__{order: {sorted, _heads}, by_tag: by_tag}) do
    if not :gb_sets.is_empty(sorted) do
      {_time, tag} = :gb_sets.smallest(sorted)
      :erlang.map_get(tag, by_tag)
    end
  end

  defp earliest([], _by_tag, _time, best), do: best

  defp earliest([tag | rest], by_tag, best_time, best) do
    input = :erlang.map_get(tag, by_tag)

    case Input.head_time(input) do
      :none -> earliest(rest, by_tag, best_time, best)
      time when best == nil or time < best_time -> earliest(rest, by_tag, time, input)
      _later -> earliest(rest, by_tag, best_time, best)
    end
  end

  @doc "Returns the number of messages taken from all inputs."
  @spec taken_count(t()) :: non_neg_integer()
  def taken_count(%__MODULE__{by_tag: by_tag}),
    do: by_tag |> Enum.map(fn {_, input} -> Input.taken_count(input) end) |> Enum.sum()

  @doc "Publishes the counts of all changed inputs and sends demand; `spent` is how many messages took how many ns."
  @spec settle_touched(t(), {non_neg_integer(), integer()}) :: t()
  def settle_touched(%__MODULE__{touched: []} = inputs, _spent), do: inputs

  def settle_touched(%__MODULE__{touched: touched} = inputs, {n, ns}),
    do: settle(touched, %{inputs | touched: []}, div(ns, max(n, 1)))

  defp settle([], inputs, _each), do: inputs

  defp settle([tag | rest], %{by_tag: by_tag} = inputs, each) do
    case by_tag do
      %{^tag => input} ->
        input = publish_counts(input, each, inputs.in_progress)
        settle(rest, %{inputs | by_tag: %{by_tag | tag => input}}, each)

      _has_closed ->
        settle(rest, inputs, each)
    end
  end

  defp publish_counts(input, each, none) when none == %{},
    do: Input.publish_counts(input, each, {0, nil})

  defp publish_counts(input, each, in_progress),
    do: Input.publish_counts(input, each, Map.get(in_progress, input.tag, {0, nil}))

  @doc "Sets on how many of the last messages of an input the component still works: `{n, time of the last finished}`."
  @spec put_progress(t(), atom(), {non_neg_integer(), Situ.Time.t() | nil}) :: t()
  def put_progress(%__MODULE__{in_progress: in_progress} = inputs, name, {n, _time} = progress) do
    case find_by_name(inputs, name) do
      nil -> inputs
      %{tag: tag} when n == 0 -> touch(%{inputs | in_progress: Map.delete(in_progress, tag)}, tag)
      %{tag: tag} -> touch(%{inputs | in_progress: Map.put(in_progress, tag, progress)}, tag)
    end
  end

  @doc "Counts the messages in progress as handled, because a component that restarts knows nothing of them."
  @spec forget_progress(t()) :: t()
  def forget_progress(%__MODULE__{in_progress: none} = inputs) when none == %{}, do: inputs

  def forget_progress(%__MODULE__{in_progress: in_progress} = inputs) do
    inputs = in_progress |> Map.keys() |> Enum.reduce(inputs, &touch(&2, &1))
    %{inputs | in_progress: %{}}
  end

  @doc "Pauses or resumes an input for the component."
  @spec set_hold(t(), atom(), boolean()) :: t()
  def set_hold(%__MODULE__{} = inputs, name, held?) do
    case find_by_name(inputs, name) do
      nil -> inputs
      input -> put(inputs, Input.set_hold(input, held?))
    end
  end
end
