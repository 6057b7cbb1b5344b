defmodule Situ.Studio.Visualizers.Bars do
  @moduledoc false
  # Draws a message as bars: a list of numbers, a map from names to numbers, or a list of `{name,
  # number}`. A map from names to such lists is several series. They can also be drawn as lines,
  # areas or a plot over x, vertically or horizontally.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.Draw.Key
  alias Situ.Studio.{Frame, Visualizer}
  alias Situ.Studio.Visualizers.SharedOptions

  @limit 1_000
  @series 16

  @kinds [
    {"bars", "bars"},
    {"stacked", "bars, stacked"},
    {"line", "lines"},
    {"area", "areas, stacked"},
    {"xy", "lines over x"}
  ]

  @impl true
  def about do
    options =
      SharedOptions.color() ++
        [
          kind: [type: {:in, @kinds}, title: "Drawn as", default: "bars"],
          lying: [type: :boolean, title: "Horizontal", default: false],
          x_title: [type: :text, title: "Title of the name axis"],
          y_title: [type: :text, title: "Title of the value axis"]
        ] ++ SharedOptions.near_cursor()

    %Visualizer{
      id: "bars",
      title: "Bars",
      panel: :bars,
      shapes: [:bars, :signals],
      options: options,
      asks: SharedOptions.requested_keys()
    }
  end

  @impl true
  def instant(channel, data, message),
    do:
      Frame.json(channel, message.originating_time, %{
        "series" => build_series(bar_rows(data), data)
      })

  defp build_series([], data), do: named_series(data)
  defp build_series(rows, _data), do: [["", rows]]

  @doc "Returns `[name, rows]` for each list in a map of lists, by name, or an empty list for any other term."
  @spec named_series(term()) :: [[String.t() | [[String.t() | number()]]]]
  def named_series(%_{}), do: []

  def named_series(map) when is_map(map) and map_size(map) in 1..@series do
    rows = for {name, [_ | _] = list} <- map, [_ | _] = rows <- [bar_rows(list)], do: {name, rows}

    if length(rows) == map_size(map),
      do:
        for(
          {name, rows} <- Enum.sort_by(rows, &Key.key_name(elem(&1, 0))),
          do: [Key.key_name(name), rows]
        ),
      else: []
  end

  def named_series(_), do: []

  @doc """
  Returns `[label, value]` pairs in order, or an empty list for a term that cannot be drawn as
  bars.

      iex> Situ.Studio.Visualizers.Bars.bar_rows(%{"b" => 2, "a" => 1.5})
      [["a", 1.5], ["b", 2]]
      iex> Situ.Studio.Visualizers.Bars.bar_rows([3, 1])
      [["0", 3], ["1", 1]]
      iex> Situ.Studio.Visualizers.Bars.bar_rows([3, :x])
      []
      iex> Situ.Studio.Visualizers.Bars.named_series(%{right: [{"go", 1}], left: [3, 4]})
      [["left", [["0", 3], ["1", 4]]], ["right", [["go", 1]]]]
  """
  @spec bar_rows(term()) :: [[String.t() | number()]]
  def bar_rows(%_{}), do: []

  def bar_rows(map) when is_map(map) and map_size(map) > 0 do
    rows = map |> Enum.take(@limit) |> Enum.sort() |> Enum.map(&build_row/1)
    if Enum.all?(rows), do: rows, else: []
  end

  def bar_rows([first | _] = list) do
    if proper_list?(list), do: list |> Enum.take(@limit) |> list_rows(first), else: []
  end

  def bar_rows(_), do: []

  defp list_rows(list, first) when is_number(first) do
    if Enum.all?(list, &is_number/1),
      do: Enum.with_index(list, fn v, i -> [Integer.to_string(i), v] end),
      else: []
  end

  defp list_rows(list, _) do
    rows = Enum.map(list, &build_row/1)
    if Enum.all?(rows), do: rows, else: []
  end

  defp build_row({label, value}) when is_number(value) do
    cond do
      is_binary(label) and String.valid?(label) -> [String.slice(label, 0, 60), value]
      is_atom(label) or is_number(label) -> [to_string(label), value]
      true -> nil
    end
  end

  defp build_row(_), do: nil

  defp proper_list?([]), do: true
  defp proper_list?([_ | rest]), do: proper_list?(rest)
  defp proper_list?(_), do: false
end
