defmodule Situ.Studio.Visualizers.Bars do
  @moduledoc """
  Bars of a message: a list of numbers, a map from names to numbers, or a list of `{name, number}`.

      iex> Situ.Studio.Visualizers.Bars.of(%{"b" => 2, "a" => 1.5})
      [["a", 1.5], ["b", 2]]
      iex> Situ.Studio.Visualizers.Bars.of([3, 1])
      [["0", 3], ["1", 1]]
      iex> Situ.Studio.Visualizers.Bars.of([3, :x])
      []
  """
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, Visualizer}
  alias Situ.Studio.Visualizers.Option

  @limit 1_000

  @impl true
  def about do
    options = Option.color()

    %Visualizer{
      id: "bars",
      title: "Bars",
      panel: :bars,
      shapes: [:bars, :signals],
      options: options
    }
  end

  @impl true
  def instant(channel, data, message),
    do: Frame.json(channel, message.originating_time, %{"bars" => of(data)})

  @doc "`[label, value]` in order; empty when `term` is nothing of the kind."
  @spec of(term()) :: [[String.t() | number()]]
  def of(%_{}), do: []

  def of(map) when is_map(map) and map_size(map) > 0 do
    rows = map |> Enum.take(@limit) |> Enum.sort() |> Enum.map(&row/1)
    if Enum.all?(rows), do: rows, else: []
  end

  def of([first | _] = list) do
    if plain?(list), do: list |> Enum.take(@limit) |> rows(first), else: []
  end

  def of(_), do: []

  defp rows(list, first) when is_number(first) do
    if Enum.all?(list, &is_number/1),
      do: Enum.with_index(list, fn v, i -> [Integer.to_string(i), v] end),
      else: []
  end

  defp rows(list, _) do
    rows = Enum.map(list, &row/1)
    if Enum.all?(rows), do: rows, else: []
  end

  defp row({label, value}) when is_number(value) do
    cond do
      is_binary(label) and String.valid?(label) -> [String.slice(label, 0, 60), value]
      is_atom(label) or is_number(label) -> [to_string(label), value]
      true -> nil
    end
  end

  defp row(_), do: nil

  defp plain?([]), do: true
  defp plain?([_ | rest]), do: plain?(rest)
  defp plain?(_), do: false
end
