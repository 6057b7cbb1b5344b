defmodule Situ.Bridge.Format.Csv.Row do
  @moduledoc false
  # One record of fields (RFC 4180): fields with commas, quotes or line breaks are quoted, and quotes are doubled.
  import Situ.Bits, only: [known: 1]

  @most 16 * 1024 * 1024

  @doc """
  Encodes fields as a record.

      iex> IO.iodata_to_binary(Situ.Bridge.Format.Csv.Row.write(["a", "b,c", ~s(say "so")]))
      ~s(a,"b,c","say ""so\"""\\r\\n)
  """
  @spec write([String.t()]) :: iodata()
  def write(fields), do: [fields |> Enum.map(&quoted/1) |> Enum.intersperse(","), "\r\n"]

  defp quoted(""), do: ""

  defp quoted(field) do
    if bare?(field) or not (special?(field) or String.trim(field) != field),
      do: field,
      else: [?", String.replace(field, "\"", "\"\""), ?"]
  end

  # Most fields, such as numbers and words, consist of visible ASCII only and need no further checks.
  defp bare?(<<c, rest::binary>>) when c in ?!..?~ and c != ?, and c != ?", do: bare?(rest)
  defp bare?(rest), do: rest == ""

  defp special?(field), do: String.contains?(field, [",", "\"", "\r", "\n"])

  @doc "Returns the first record and the remaining bytes; `:more` if it is incomplete. `last?`: no bytes follow."
  @spec read(binary(), boolean()) :: {:ok, [String.t()], binary()} | :more | {:error, String.t()}
  def read(bytes, _last?) when byte_size(bytes) == 0, do: :more
  def read(bytes, last?), do: field(bytes, last?, [])

  defp field(<<?", rest::binary>>, last?, done), do: within(rest, last?, [], done)

  defp field(bytes, last?, done) do
    case :binary.match(bytes, [",", "\n"]) do
      {at, 1} ->
        <<text::binary-known(at), mark, rest::binary>> = bytes
        next(mark, :binary.copy(text), rest, last?, done)

      :nomatch when last? ->
        {:ok, Enum.reverse([String.trim_trailing(bytes, "\r") | done]), ""}

      :nomatch ->
        more(bytes)
    end
  end

  defp next(?,, text, rest, last?, done), do: field(rest, last?, [text | done])

  defp next(?\n, text, rest, _last?, done),
    do: {:ok, Enum.reverse([String.trim_trailing(text, "\r") | done]), rest}

  defp within(bytes, last?, parts, done) do
    case :binary.match(bytes, "\"") do
      {at, 1} ->
        <<text::binary-known(at), ?", rest::binary>> = bytes
        quote_met(rest, last?, [parts, text], done)

      :nomatch ->
        more(bytes)
    end
  end

  defp quote_met(<<?", rest::binary>>, last?, parts, done),
    do: within(rest, last?, [parts, ?"], done)

  defp quote_met(<<?,, rest::binary>>, last?, parts, done),
    do: field(rest, last?, [text(parts) | done])

  defp quote_met(<<"\r\n", rest::binary>>, _last?, parts, done),
    do: {:ok, Enum.reverse([text(parts) | done]), rest}

  defp quote_met(<<"\n", rest::binary>>, _last?, parts, done),
    do: {:ok, Enum.reverse([text(parts) | done]), rest}

  defp quote_met("", true, parts, done), do: {:ok, Enum.reverse([text(parts) | done]), ""}
  defp quote_met(rest, false, _parts, _done) when rest in ["", "\r"], do: :more

  defp quote_met(_rest, _last?, _parts, _done),
    do: {:error, "a quoted field has characters after its closing quote"}

  defp text(parts), do: IO.iodata_to_binary(parts)

  defp more(bytes) when byte_size(bytes) > @most,
    do: {:error, "a field is longer than #{@most} bytes"}

  defp more(_bytes), do: :more
end
