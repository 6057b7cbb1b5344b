defmodule Situ.CsvRow do
  @moduledoc false
  # One record of a CSV text (RFC 4180): fields with commas, quotes or line breaks are quoted, and quotes are doubled.
  # Whole CSV files are read by native code (`Situ.Store.Csv`).
  import Situ.BinarySize, only: [pinned_size: 1]

  @max_field 16 * 1024 * 1024

  @doc """
  Encodes fields as a record.

      iex> IO.iodata_to_binary(Situ.CsvRow.encode_row(["a", "b,c", ~s(say "so")]))
      ~s(a,"b,c","say ""so\"""\\r\\n)
  """
  @spec encode_row([String.t()]) :: iodata()
  def encode_row(fields),
    do: [fields |> Enum.map(&quote_field/1) |> Enum.intersperse(","), "\r\n"]

  defp quote_field(""), do: ""

  defp quote_field(field) do
    if plain_ascii?(field) or not (needs_quotes?(field) or String.trim(field) != field),
      do: field,
      else: [?", String.replace(field, "\"", "\"\""), ?"]
  end

  # Most fields, such as numbers and words, consist of visible ASCII only and need no further checks.
  defp plain_ascii?(<<c, rest::binary>>) when c in ?!..?~ and c != ?, and c != ?",
    do: plain_ascii?(rest)

  defp plain_ascii?(rest), do: rest == ""

  defp needs_quotes?(field), do: String.contains?(field, [",", "\"", "\r", "\n"])

  @doc """
  Returns all records of a text. Empty lines are left out. The error is a sentence.

      iex> Situ.CsvRow.parse_rows(~s(a,b\\n\\n1,"2,3"))
      {:ok, [["a", "b"], ["1", "2,3"]]}
      iex> Situ.CsvRow.parse_rows(~s(a,"b))
      {:error, "a quoted field has no closing quote"}
  """
  @spec parse_rows(binary()) :: {:ok, [[String.t()]]} | {:error, String.t()}
  def parse_rows(text), do: parse_rows(text, [])

  defp parse_rows("", rows), do: {:ok, Enum.reverse(rows)}

  defp parse_rows(text, rows) do
    case parse_row(text, true) do
      {:ok, [""], rest} -> parse_rows(rest, rows)
      {:ok, row, rest} -> parse_rows(rest, [row | rows])
      :more -> {:error, "a quoted field has no closing quote"}
      error -> error
    end
  end

  @doc "Returns the first record and the remaining bytes; `:more` if it is incomplete. `last?`: no bytes follow."
  @spec parse_row(binary(), boolean()) ::
          {:ok, [String.t()], binary()} | :more | {:error, String.t()}
  def parse_row(bytes, _last?) when byte_size(bytes) == 0, do: :more
  def parse_row(bytes, last?), do: parse_field(bytes, last?, [])

  defp parse_field(<<?", rest::binary>>, last?, fields), do: parse_quoted(rest, last?, [], fields)

  defp parse_field(bytes, last?, fields) do
    case :binary.match(bytes, [",", "\n"]) do
      {at, 1} ->
        <<text::binary-pinned_size(at), separator, rest::binary>> = bytes
        after_field(separator, :binary.copy(text), rest, last?, fields)

      :nomatch when last? ->
        {:ok, Enum.reverse([String.trim_trailing(bytes, "\r") | fields]), ""}

      :nomatch ->
        need_more(bytes)
    end
  end

  defp after_field(?,, text, rest, last?, fields), do: parse_field(rest, last?, [text | fields])

  defp after_field(?\n, text, rest, _last?, fields),
    do: {:ok, Enum.reverse([String.trim_trailing(text, "\r") | fields]), rest}

  defp parse_quoted(bytes, last?, parts, fields) do
    case :binary.match(bytes, "\"") do
      {at, 1} ->
        <<text::binary-pinned_size(at), ?", rest::binary>> = bytes
        after_quote(rest, last?, [parts, text], fields)

      :nomatch ->
        need_more(bytes)
    end
  end

  defp after_quote(<<?", rest::binary>>, last?, parts, fields),
    do: parse_quoted(rest, last?, [parts, ?"], fields)

  defp after_quote(<<?,, rest::binary>>, last?, parts, fields),
    do: parse_field(rest, last?, [join_parts(parts) | fields])

  defp after_quote(<<"\r\n", rest::binary>>, _last?, parts, fields),
    do: {:ok, Enum.reverse([join_parts(parts) | fields]), rest}

  defp after_quote(<<"\n", rest::binary>>, _last?, parts, fields),
    do: {:ok, Enum.reverse([join_parts(parts) | fields]), rest}

  defp after_quote("", true, parts, fields),
    do: {:ok, Enum.reverse([join_parts(parts) | fields]), ""}

  defp after_quote(rest, false, _parts, _done) when rest in ["", "\r"], do: :more

  defp after_quote(_rest, _last?, _parts, _done),
    do: {:error, "a quoted field has characters after its closing quote"}

  defp join_parts(parts), do: IO.iodata_to_binary(parts)

  defp need_more(bytes) when byte_size(bytes) > @max_field,
    do: {:error, "a field is longer than #{@max_field} bytes"}

  defp need_more(_bytes), do: :more
end
