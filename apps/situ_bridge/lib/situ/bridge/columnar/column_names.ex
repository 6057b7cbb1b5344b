defmodule Situ.Bridge.Columnar.ColumnNames do
  @moduledoc false
  # Column names. A file may have several columns of the same name, but a row is a map and can hold only one. Pure.

  @doc """
  Appends numbers to duplicate column names, so that all names are different.

      iex> columns = for name <- ["x", "x", "x_1", "x"], do: %{name: name}
      iex> for column <- Situ.Bridge.Columnar.ColumnNames.number_duplicates(columns), do: column.name
      ["x", "x_2", "x_1", "x_3"]
  """
  @spec number_duplicates([column]) :: [column]
        when column: %{required(:name) => String.t(), optional(atom()) => term()}
  def number_duplicates(columns) do
    taken = MapSet.new(columns, & &1.name)
    {columns, _} = Enum.map_reduce(columns, {MapSet.new(), taken, %{}}, &rename_duplicate/2)
    columns
  end

  defp rename_duplicate(%{name: name} = column, {seen, taken, numbers}) do
    if name in seen do
      {free, n} = free_name(name, taken, Map.get(numbers, name, 0) + 1)
      {%{column | name: free}, {seen, MapSet.put(taken, free), Map.put(numbers, name, n)}}
    else
      {column, {MapSet.put(seen, name), taken, numbers}}
    end
  end

  defp free_name(name, taken, n) do
    free = "#{name}_#{n}"
    if free in taken, do: free_name(name, taken, n + 1), else: {free, n}
  end
end
