defmodule Situ.Studio.Experiments.SetList do
  @moduledoc false
  # Sorts the sets of a run by a column, and groups them into curves over one parameter. Pure.
  alias Situ.Experiment.Summary
  alias Situ.Studio.Experiments.Axis

  @doc """
  Sorts rows by a column: `set`, `sessions`, `p.NAME` or `m.NAME`; a `-` before it reverses the order. Without a known
  column, the order stays: the best set first. Undefined values come last.

      iex> rows = for {n, x} <- [{1, 0.5}, {2, nil}, {3, 0.9}], do: %{number: n, metrics: %{"voice" => %{value: x}}}
      iex> for order <- ["-m.voice", "m.voice", "-set", "x"],
      ...>     do: rows |> Situ.Studio.Experiments.SetList.sort_rows(order) |> Enum.map(& &1.number)
      [[3, 1, 2], [1, 3, 2], [3, 2, 1], [1, 2, 3]]
  """
  @spec sort_rows([Summary.row()], String.t()) :: [Summary.row()]
  def sort_rows(rows, "-" <> column), do: sort_by_column(rows, column, :desc)
  def sort_rows(rows, column), do: sort_by_column(rows, column, :asc)

  defp sort_by_column([first | _] = rows, column, order) do
    case read_column(column, first) do
      :unknown ->
        rows

      {:ok, value} ->
        {known, unknown} = Enum.split_with(rows, &(value.(&1) != nil))
        Enum.sort_by(known, value, order) ++ unknown
    end
  end

  defp sort_by_column([], _column, _order), do: []

  defp read_column("set", _row), do: {:ok, & &1.number}
  defp read_column("sessions", _row), do: {:ok, & &1.sessions}

  defp read_column("p." <> name, %{parameters: parameters}) when is_map_key(parameters, name),
    do: {:ok, & &1.parameters[name]}

  defp read_column("m." <> name, %{metrics: metrics}) when is_map_key(metrics, name),
    do: {:ok, & &1.metrics[name].value}

  defp read_column(_column, _row), do: :unknown

  @doc """
  Groups rows into curves over a parameter: all other parameters of a curve are equal. Returns each curve with its rows
  in the order of the axis.
  """
  @spec group_curves([Summary.row()], Axis.t()) :: [[Summary.row(), ...]]
  def group_curves(rows, %Axis{parameter: name} = axis) do
    rows
    |> Enum.filter(&Axis.locate(axis, &1))
    |> Enum.group_by(&Map.delete(&1.parameters, name))
    |> Enum.sort()
    |> Enum.map(fn {_, curve} -> Enum.sort_by(curve, &Axis.locate(axis, &1)) end)
  end
end
