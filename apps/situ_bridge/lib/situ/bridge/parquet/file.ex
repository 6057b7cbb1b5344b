defmodule Situ.Bridge.Parquet.File do
  @moduledoc false
  # Reads a Parquet file: its columns, and the rows of its row groups, a few at a time.
  @behaviour Situ.Bridge.Columnar.Reader
  alias Situ.Bridge.Columnar.ColumnNames
  alias Situ.Bridge.Parquet.Program

  @enforce_keys [:path, :columns, :groups, :times]
  defstruct @enforce_keys ++ [left_out: []]

  @type column :: %{name: String.t(), number: non_neg_integer(), time?: boolean()}
  @typedoc "A group is its number and its number of rows."
  @type group :: {non_neg_integer(), rows :: integer()}
  @type t :: %__MODULE__{
          path: Path.t(),
          columns: [column()],
          groups: [group()],
          times: [String.t()],
          left_out: []
        }

  # Reads only the footer. Errors: `:io`, `:not_parquet`.
  @impl true
  def open(path) do
    Program.with_program(fn program ->
      with {:ok, {:ok, columns, groups}} <- Program.call(program, path, open_request(path)),
           do: {:ok, build_table(path, columns, groups)}
    end)
  end

  defp open_request(path), do: {:open, Path.expand(path)}

  defp build_table(path, columns, groups) do
    columns =
      for(
        {{name, time?}, number} <- Enum.with_index(columns),
        do: %{name: name, number: number, time?: time?}
      )
      |> ColumnNames.number_duplicates()

    %__MODULE__{
      path: path,
      columns: columns,
      groups: for({rows, number} <- Enum.with_index(groups), do: {number, rows}),
      times: for(%{time?: true, name: name} <- columns, do: name)
    }
  end

  @impl true
  def select_groups(%{groups: groups}, _time, {nil, nil}), do: groups

  def select_groups(table, time, range) do
    Program.with_program(fn program ->
      Program.call!(program, table.path, open_request(table.path))
      ranges = Program.call!(program, table.path, {:ranges, time.number})

      for {group, times} <- Enum.zip(table.groups, ranges),
          ranges_overlap?(times, range),
          do: group
    end)
  end

  defp ranges_overlap?(nil, _range), do: true

  defp ranges_overlap?({first, last}, {from, to}),
    do: (from == nil or last >= from) and (to == nil or first <= to)

  @impl true
  def stream_rows(table, groups, columns), do: stream_results(table, groups, columns, {:rows})

  @doc """
  Returns the values of the columns, some rows at a time, as `{rows, values}`. The values of a column are
  `{:integer | :float | :boolean, bytes}`, or a list if values are missing or have another type.
  """
  @spec stream_columns(t(), [group()], [column()]) :: Enumerable.t()
  def stream_columns(table, groups, columns),
    do: stream_results(table, groups, columns, {:columns})

  defp stream_results(table, groups, columns, request) do
    numbers = Enum.map(columns, & &1.number)

    Stream.resource(
      fn -> {start_reading(table), groups, 0} end,
      &next_rows(&1, table.path, numbers, request),
      fn {program, _, _} -> Program.stop_program(program) end
    )
  end

  # If the start function raises, `Stream.resource/3` does not call the last function.
  defp start_reading(table) do
    program = Program.start_program()

    case Program.call(program, table.path, open_request(table.path)) do
      {:ok, _columns} ->
        program

      {:error, error} ->
        Program.stop_program(program)
        raise error
    end
  end

  defp next_rows({_program, [], 0} = state, _path, _numbers, _request), do: {:halt, state}

  defp next_rows({program, [{group, rows} | groups], 0}, path, numbers, _request) do
    :ok = Program.call!(program, path, {:group, group, numbers})
    {[], {program, groups, rows}}
  end

  defp next_rows({program, groups, remaining}, path, _numbers, request) do
    {rows, values} = Program.call!(program, path, request)
    results = if request == {:rows}, do: values, else: [{rows, values}]
    {results, {program, groups, remaining - rows}}
  end
end
