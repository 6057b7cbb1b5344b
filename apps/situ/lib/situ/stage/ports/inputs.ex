defmodule Situ.Stage.Inputs do
  @moduledoc false
  # The inputs of a stage by their tags: which is next, and what is asked of their producers.
  alias Situ.Stage.Input

  defstruct by_tag: %{}, lossy: false

  @typedoc "`lossy`: whether one of them drops."
  @type t :: %__MODULE__{by_tag: %{term() => Input.t()}, lossy: boolean()}

  @spec new([Input.t()]) :: t()
  def new(inputs), do: Enum.reduce(inputs, %__MODULE__{}, &put(&2, &1))

  @doc "Adds or changes an input."
  @spec put(t(), Input.t()) :: t()
  def put(%__MODULE__{by_tag: by_tag, lossy: lossy} = inputs, %Input{tag: tag} = input),
    do: %{inputs | by_tag: Map.put(by_tag, tag, input), lossy: lossy or Input.lossy?(input)}

  @spec delete(t(), term()) :: t()
  def delete(%__MODULE__{} = inputs, tag), do: %{inputs | by_tag: Map.delete(inputs.by_tag, tag)}

  @doc "The only input of a chain."
  @spec only(t()) :: Input.t() | nil
  def only(%__MODULE__{by_tag: by_tag}) do
    case Map.to_list(by_tag) do
      [{_tag, input}] -> input
      [] -> nil
    end
  end

  @spec find(t(), atom()) :: Input.t() | nil
  def find(%__MODULE__{by_tag: by_tag}, name),
    do: Enum.find_value(by_tag, fn {_, input} -> if input.name == name, do: input end)

  @doc "The input whose head is the oldest."
  @spec earliest(t()) :: Input.t() | nil
  def earliest(%__MODULE__{by_tag: by_tag}) when map_size(by_tag) == 0, do: nil
  def earliest(%__MODULE__{by_tag: by_tag}), do: earliest(Map.to_list(by_tag), nil, nil)

  defp earliest([], _time, best), do: best

  defp earliest([{_tag, input} | rest], best_time, best) do
    case Input.head_time(input) do
      :none -> earliest(rest, best_time, best)
      time when best == nil or time < best_time -> earliest(rest, time, input)
      _later -> earliest(rest, best_time, best)
    end
  end

  @doc "Publishes counts and asks for more."
  @spec settle(t()) :: t()
  def settle(%__MODULE__{by_tag: by_tag} = inputs) do
    case Map.to_list(by_tag) do
      [] ->
        inputs

      [{tag, input}] ->
        settle_one(inputs, tag, input)

      many ->
        Enum.reduce(many, inputs, fn {tag, input}, inputs -> settle_one(inputs, tag, input) end)
    end
  end

  defp settle_one(inputs, tag, input) do
    case Input.settle(input) do
      ^input -> inputs
      input -> %{inputs | by_tag: %{inputs.by_tag | tag => input}}
    end
  end

  @doc "The component holds an input, or resumes it."
  @spec hold(t(), atom(), boolean()) :: t()
  def hold(%__MODULE__{} = inputs, name, held?) do
    case find(inputs, name) do
      nil -> inputs
      input -> put(inputs, Input.hold(input, held?))
    end
  end
end
