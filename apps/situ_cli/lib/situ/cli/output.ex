defmodule Situ.CLI.Output do
  @moduledoc false
  # Prints all output. Control characters in text from recordings could move the cursor or rename the terminal's window,
  # so they are escaped, and so are bytes that are not UTF-8.

  @doc "Prints one or several lines for people."
  @spec puts(String.t()) :: :ok
  def puts(text), do: IO.puts(escape_control(text, ~r/[\x00-\x08\x0b-\x1f\x7f-\x{9f}]/u))

  @doc "Prints a line to standard error."
  @spec warn(String.t()) :: :ok
  def warn(text), do: IO.puts(:stderr, escape_control(text, ~r/[\x00-\x08\x0b-\x1f\x7f-\x{9f}]/u))

  @doc "Prints a value for programs, as one line of JSON."
  @spec print_json(Situ.JSON.value()) :: :ok
  def print_json(value), do: IO.puts(Situ.JSON.encode(value))

  @doc "Writes bytes unchanged; text output would encode them as UTF-8 once more."
  @spec write_raw(binary()) :: :ok
  def write_raw(bytes) do
    before = :io.getopts(:standard_io)
    _ = :io.setopts(:standard_io, encoding: :latin1)
    IO.binwrite(bytes)
    encoding = if is_list(before), do: before[:encoding]
    _ = :io.setopts(:standard_io, encoding: encoding || :unicode)
    :ok
  end

  @doc "Formats a name for a cell or the middle of a line, with line feeds escaped as well."
  @spec format_name(String.t()) :: String.t()
  def format_name(text), do: escape_control(text, ~r/[\x00-\x1f\x7f-\x{9f}]/u)

  defp escape_control(text, control) do
    text
    |> String.chunk(:valid)
    |> Enum.map_join(fn part ->
      if String.valid?(part),
        do: Regex.replace(control, part, &escape_character/1),
        else: for(<<byte <- part>>, into: "", do: "\\x" <> Base.encode16(<<byte>>))
    end)
  end

  defp escape_character("\e"), do: "\\e"
  defp escape_character("\n"), do: "\\n"
  defp escape_character("\t"), do: "\\t"
  defp escape_character("\r"), do: "\\r"
  defp escape_character(<<code::utf8>>), do: "\\x" <> Base.encode16(<<code>>)

  @doc "Prints a table whose first row is the header; `left` columns are left-aligned, the others right-aligned."
  @spec print_table([[String.t()]], non_neg_integer(), String.t()) :: :ok
  def print_table(rows, left, indent \\ "  ") do
    rows = for row <- rows, do: Enum.map(row, &format_name/1)

    widths =
      rows
      |> Enum.zip_with(& &1)
      |> Enum.map(fn cells -> cells |> Enum.map(&String.length/1) |> Enum.max() end)

    for row <- rows do
      cells =
        for {{cell, width}, column} <- row |> Enum.zip(widths) |> Enum.with_index() do
          if column < left,
            do: String.pad_trailing(cell, width),
            else: String.pad_leading(cell, width)
        end

      IO.puts(indent <> String.trim_trailing(Enum.join(cells, "  ")))
    end

    :ok
  end

  @doc "Formats a size in bytes."
  @spec format_bytes(non_neg_integer()) :: String.t()
  def format_bytes(n) when n >= 1_000_000_000, do: "#{Float.round(n / 1.0e9, 2)} GB"
  def format_bytes(n) when n >= 1_000_000, do: "#{Float.round(n / 1.0e6, 2)} MB"
  def format_bytes(n) when n >= 1_000, do: "#{Float.round(n / 1.0e3, 1)} kB"
  def format_bytes(n), do: "#{n} B"

  @doc "Formats a count with its noun: `1 stream`, `2 streams`."
  @spec format_count(non_neg_integer(), String.t()) :: String.t()
  def format_count(1, noun), do: "1 #{noun}"
  def format_count(n, noun), do: "#{n} #{noun}s"
end
