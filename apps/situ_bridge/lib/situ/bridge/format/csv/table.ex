defmodule Situ.Bridge.Format.Csv.Table do
  @moduledoc false
  # A CSV file of a whole recorded stream, with a column for every number and text in its messages. The format `:csv`
  # (`Situ.Bridge.Format.Csv`) must write its heading before it knows more than the first message, and omits lists like
  # \psi. Here all messages are read first, so that nothing is left out: elements of a list have columns such as
  # `acceleration[0]` and `faces[1].left`.
  alias Situ.Bridge.Format.{Csv, TimeFormat, Value}
  alias Situ.{Columns, CsvRow, Error, Message}

  @most_columns 1_000
  @time "_OriginatingTime_"

  @typedoc "The path of a value in a message, and the title of its column."
  @type column :: {path :: [String.t()], title :: String.t()}

  @doc """
  Returns the columns of all messages in the parts of a stream (`Situ.Store.columns/3`), or `:plain` for a stream of
  plain numbers, which the format `:csv` writes faster. Raises `Situ.Error` (`:not_writable`).
  """
  @spec collect_columns(Enumerable.t()) :: [column()] | :plain
  def collect_columns(parts) do
    parts
    |> Enum.reduce_while([], fn
      %Columns{}, _paths ->
        {:halt, :plain}

      messages, paths ->
        {:cont, Enum.reduce(messages, paths, &add_paths(list_cells(&1.data), &2))}
    end)
    |> title_columns()
  end

  # The paths of most messages are the same.
  defp add_paths(cells, paths) do
    case Enum.map(cells, &elem(&1, 0)) do
      ^paths -> paths
      found -> limit_columns(paths ++ (found -- paths))
    end
  end

  defp limit_columns(paths) when length(paths) <= @most_columns, do: paths

  defp limit_columns(_paths) do
    raise Error.new(:not_writable, "the messages have more than #{@most_columns} values each",
            fix: "write Parquet, JSON lines or MessagePack"
          )
  end

  defp title_columns(:plain), do: :plain

  # A member is named without the object that contains it, unless two members have the same name.
  defp title_columns(paths) do
    names = Enum.frequencies_by(paths, &List.last/1)

    for path <- paths,
        name = List.last(path),
        do: {path, if(names[name] == 1, do: name, else: Enum.join(path, "."))}
  end

  @spec encode_heading([column()]) :: iodata()
  def encode_heading(columns), do: CsvRow.encode_row([@time | Enum.map(columns, &elem(&1, 1))])

  @doc "Encodes messages as records. Values that a message lacks are empty fields."
  @spec encode_rows([Message.t()], [column()]) :: iodata()
  def encode_rows(messages, columns) do
    for message <- messages do
      cells = message.data |> list_cells() |> Map.new()
      fields = for {path, _title} <- columns, do: Csv.format_field(cells[path])
      CsvRow.encode_row([TimeFormat.to_iso8601(message.originating_time) | fields])
    end
  end

  defp list_cells(data) do
    case Value.to_plain(data) do
      {pairs} -> Enum.flat_map(pairs, &member_cells(&1, []))
      list when is_list(list) -> index_cells(list, &["_Column#{&1}_"])
      value -> [{["_Value_"], value}]
    end
  catch
    {:not_writable, value} -> raise Situ.Bridge.Format.not_writable_error(:csv, value)
  end

  defp member_cells({key, {pairs}}, path),
    do: Enum.flat_map(pairs, &member_cells(&1, path ++ [key]))

  defp member_cells({key, value}, path), do: element_cells(value, path ++ [key])

  defp element_cells({pairs}, path) do
    for {key, value} <- pairs,
        cell <- element_cells(value, extend_name(path, ".#{key}")),
        do: cell
  end

  defp element_cells(list, path) when is_list(list),
    do: index_cells(list, &extend_name(path, "[#{&1}]"))

  defp element_cells(value, path), do: [{path, value}]

  defp index_cells(list, path) do
    for {value, i} <- Enum.with_index(list), cell <- element_cells(value, path.(i)), do: cell
  end

  defp extend_name(path, text), do: List.update_at(path, -1, &(&1 <> text))
end
