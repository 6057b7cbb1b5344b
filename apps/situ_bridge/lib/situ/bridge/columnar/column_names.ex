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
    all_names = MapSet.new(columns, & &1.name)
    {columns, _} = Enum.map_reduce(columns, {MapSet.new(), all_names, %{}}, &rename_duplicate/2)
    columns
  end

  defp rename_duplicate(%{name: name} = column, {previous, all_names, numbers}) do
    if name in previous do
      {new_name, n} = free_name(name, all_names, Map.get(numbers, name, 0) + 1)

      {%{column | name: new_name},
       {previous, MapSet.put(all_names, new_name), Map.put(numbers, name, n)}}
    else
      {column, {MapSet.put(previous, name), all_names, numbers}}
    end
  end

  defp free_name(name, all_names, n) do
    new_name = "#{name}_#{n}"
    if new_name in all_names, do: free_name(name, all_names, n + 1), else: {new_name, n}
  end
end
