defmodule Situ.Expression.Lexer do
  @moduledoc false
  # Splits text into tokens `{kind, value, position}`; positions are counted in characters from 1.

  @operators ~w(== != <= >= < > + - * / % . , \( \) [ ])
  @words ~w(and or not in true false null)
  @units %{
    "ns" => 1,
    "us" => 1_000,
    "ms" => 1_000_000,
    "s" => 1_000_000_000,
    "min" => 60_000_000_000,
    "h" => 3_600_000_000_000
  }
  @longest 10_000

  @type token :: {:number | :text | :name | :operator | :end, term(), pos_integer()}

  @spec tokenize(String.t()) :: {:ok, [token()]} | {:error, pos_integer(), String.t()}
  def tokenize(text) do
    cond do
      not String.valid?(text) ->
        {:error, 1, "it is not UTF-8"}

      String.length(text) > @longest ->
        {:error, @longest, "it is longer than #{@longest} characters"}

      true ->
        scan_tokens(text, 1, [])
    end
  end

  defp scan_tokens("", at, done), do: {:ok, Enum.reverse([{:end, nil, at} | done])}

  defp scan_tokens(<<c, rest::binary>>, at, done) when c in ~c" \t\r\n",
    do: scan_tokens(rest, at + 1, done)

  defp scan_tokens(<<quote, rest::binary>>, at, done) when quote in [?', ?", ?`] do
    case scan_quoted(rest, quote, "", 1) do
      {:ok, value, rest, used} ->
        kind = if quote == ?`, do: :name, else: :text
        scan_tokens(rest, at + used, [{kind, value, at} | done])

      :error ->
        {:error, at, "the closing #{<<quote>>} is missing"}
    end
  end

  defp scan_tokens(<<c, _::binary>> = text, at, done) when c in ?0..?9 do
    [number, unit] =
      Regex.run(~r/\A(\d+(?:\.\d+)?(?:[eE][-+]?\d{1,3})?)([a-zA-Z]*)/, text,
        capture: :all_but_first
      )

    used = byte_size(number) + byte_size(unit)
    rest = binary_part(text, used, byte_size(text) - used)

    case parse_number(number, unit) do
      {:ok, value} -> scan_tokens(rest, at + used, [{:number, value, at} | done])
      {:error, why} -> {:error, at, why}
    end
  end

  defp scan_tokens(text, at, done) do
    case Regex.run(~r/\A[\p{L}_][\p{L}\p{N}_]*/u, text) do
      [word] ->
        kind = if word in @words, do: :operator, else: :name
        rest = binary_part(text, byte_size(word), byte_size(text) - byte_size(word))
        scan_tokens(rest, at + String.length(word), [{kind, word, at} | done])

      nil ->
        scan_operator(text, at, done)
    end
  end

  defp scan_operator(text, at, done) do
    case Enum.find(@operators, &String.starts_with?(text, &1)) do
      nil ->
        {:error, at, "unexpected character #{inspect(String.first(text))}"}

      operator ->
        size = byte_size(operator)

        scan_tokens(binary_part(text, size, byte_size(text) - size), at + size, [
          {:operator, operator, at} | done
        ])
    end
  end

  # A quotation mark inside quoted text is written twice.
  defp scan_quoted(<<q, q, rest::binary>>, q, value, used),
    do: scan_quoted(rest, q, value <> <<q>>, used + 2)

  defp scan_quoted(<<q, rest::binary>>, q, value, used), do: {:ok, value, rest, used + 1}

  defp scan_quoted(<<c::utf8, rest::binary>>, q, value, used),
    do: scan_quoted(rest, q, value <> <<c::utf8>>, used + 1)

  defp scan_quoted("", _q, _value, _used), do: :error

  defp parse_number(text, ""), do: parse_digits(text)

  defp parse_number(text, unit) do
    with {:ok, n} <- parse_digits(text),
         {:ok, factor} <- Map.fetch(@units, unit) do
      {:ok, if(is_integer(n), do: n * factor, else: round(n * factor))}
    else
      :error ->
        {:error,
         "#{inspect(unit)} is not a unit of time (#{@units |> Map.keys() |> Enum.sort() |> Enum.join(", ")})"}

      error ->
        error
    end
  end

  defp parse_digits(text) do
    if byte_size(text) > 60 do
      {:error, "the number is too long"}
    else
      case Integer.parse(text) do
        {n, ""} -> {:ok, n}
        _ -> parse_float(text)
      end
    end
  end

  # A number such as 1e999 is not a float.
  defp parse_float(text) do
    {x, ""} = Float.parse(text)
    {:ok, x}
  rescue
    _ in [ArgumentError, MatchError] -> {:error, "the number is too large"}
  end
end
