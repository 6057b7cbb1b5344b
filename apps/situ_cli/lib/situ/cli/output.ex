defmodule Situ.CLI.Output do
  @moduledoc false
  # Prints all output. Control characters in text from recordings could move the cursor or rename the terminal's window,
  # so they are escaped, and so are bytes that are not UTF-8.

  @doc "Prints one or several lines for people."
  @spec puts(String.t()) :: :ok
  def puts(text), do: IO.puts(clean(text, ~r/[\x00-\x08\x0b-\x1f\x7f-\x{9f}]/u))

  @doc "Prints a line to standard error."
  @spec warn(String.t()) :: :ok
  def warn(text), do: IO.puts(:stderr, clean(text, ~r/[\x00-\x08\x0b-\x1f\x7f-\x{9f}]/u))

  @doc "Prints a value for programs, as one line of JSON."
  @spec json(Situ.JSON.value()) :: :ok
  def json(value), do: IO.puts(Situ.JSON.encode(value))

  @doc "Writes bytes unchanged; text output would encode them as UTF-8 once more."
  @spec raw(binary()) :: :ok
  def raw(bytes) do
    before = :io.getopts(:standard_io)
    _ = :io.setopts(:standard_io, encoding: :latin1)
    IO.binwrite(bytes)
    encoding = if is_list(before), do: before[:encoding]
    _ = :io.setopts(:standard_io, encoding: encoding || :unicode)
    :ok
  end

  @doc "Formats a name for a cell or the middle of a line, with line feeds escaped as well."
  @spec name(String.t()) :: String.t()
  def name(text), do: clean(text, ~r/[\x00-\x1f\x7f-\x{9f}]/u)

  defp clean(text, control) do
    text
    |> String.chunk(:valid)
    |> Enum.map_join(fn part ->
      if String.valid?(part),
        do: Regex.replace(control, part, &escape/1),
        else: for(<<byte <- part>>, into: "", do: "\\x" <> Base.encode16(<<byte>>))
    end)
  end

  defp escape("\e"), do: "\\e"
  defp escape("\n"), do: "\\n"
  defp escape("\t"), do: "\\t"
  defp escape("\r"), do: "\\r"
  defp escape(<<code::utf8>>), do: "\\x" <> Base.encode16(<<code>>)

  @doc "Prints a table whose first row is the header; `left` columns are left-aligned, the others right-aligned."
  @spec table([[String.t()]], non_neg_integer(), String.t()) :: :ok
  def table(rows, left, indent \\ "  ") do
    rows = for row <- rows, do: Enum.map(row, &name/1)

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
  @spec bytes(non_neg_integer()) :: String.t()
  def bytes(n) when n >= 1_000_000_000, do: "#{Float.round(n / 1.0e9, 2)} GB"
  def bytes(n) when n >= 1_000_000, do: "#{Float.round(n / 1.0e6, 2)} MB"
  def bytes(n) when n >= 1_000, do: "#{Float.round(n / 1.0e3, 1)} kB"
  def bytes(n), do: "#{n} B"

  @doc "Formats a count with its noun: `1 stream`, `2 streams`."
  @spec number(non_neg_integer(), String.t()) :: String.t()
  def number(1, noun), do: "1 #{noun}"
  def number(n, noun), do: "#{n} #{noun}s"
end
