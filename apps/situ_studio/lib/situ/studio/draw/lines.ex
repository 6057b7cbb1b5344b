defmodule Situ.Studio.Draw.Lines do
  @moduledoc """
  Lines from messages: one of numbers, or one for each key of maps of numbers. Where a value is missing, or `nil`, a line
  has a gap.

      iex> messages = for {t, v} <- [{0, %{a: 1}}, {1, %{a: 2, b: 5}}, {2, %{b: 6}}], do: %Situ.Message{data: v, originating_time: t}
      iex> Situ.Studio.Draw.Lines.of_maps(messages, [])
      [{"a", [{0, 1, 1, 1, 1}, {1, 2, 2, 2, 1}, {2, nil, nil, nil, 1}]}, {"b", [{1, 5, 5, 5, 1}, {2, 6, 6, 6, 1}]}]
  """
  alias Situ.Studio.{Draw, Path}
  alias Draw.{Bins, Key}

  @type line :: [Bins.point()]

  @doc "The line of the number at `path` in each message."
  @spec of([Situ.Message.t()], Path.t()) :: line()
  def of(messages, path) do
    for message <- messages, point <- one(message, path), do: point
  end

  defp one(%{data: data, originating_time: time}, path) do
    case Path.fetch(data, path) do
      {:ok, value} -> Bins.points(time, value)
      :error -> [Bins.gap(time)]
    end
  end

  @doc "A line for each key of the maps at `path`, by the keys' names."
  @spec of_maps([Situ.Message.t()], Path.t()) :: [{name :: String.t(), line()}]
  def of_maps(messages, path) do
    lines = Enum.reduce(messages, %{}, &add(&2, &1, path))

    for key <- Key.sort(Map.keys(lines)),
        line = Enum.reverse(lines[key]),
        Enum.any?(line, &(not Bins.gap?(&1))),
        do: {Key.text(key), line}
  end

  defp add(lines, %{data: data, originating_time: time}, path) do
    values =
      case Path.fetch(data, path) do
        {:ok, map} when is_map(map) and not is_struct(map) -> map
        _ -> %{}
      end

    lines
    |> end_missing(values, time)
    |> then(&Enum.reduce(values, &1, fn {key, value}, lines -> put(lines, key, time, value) end))
  end

  defp put(lines, key, time, value) do
    case {Bins.points(time, value), lines} do
      {[], _} -> lines
      {[point], %{^key => line}} -> %{lines | key => [point | line]}
      {[point], _} -> Map.put(lines, key, [point])
    end
  end

  # A key that is no longer there ends its line, once.
  defp end_missing(lines, values, time) do
    Enum.reduce(lines, lines, fn {key, [last | _] = line}, lines ->
      if is_map_key(values, key) or Bins.gap?(last),
        do: lines,
        else: %{lines | key => [Bins.gap(time) | line]}
    end)
  end
end
