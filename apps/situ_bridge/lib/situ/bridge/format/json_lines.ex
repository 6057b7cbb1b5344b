defmodule Situ.Bridge.Format.JsonLines do
  @moduledoc false
  # Encodes each message as one line of JSON.
  @behaviour Situ.Bridge.Format
  alias Situ.Bridge.Format.Json

  @max_line 64 * 1024 * 1024

  @impl true
  defdelegate encode(value, time), to: Json
  @impl true
  defdelegate decode(bytes, opts), to: Json

  @impl true
  def record(value, time, _n), do: [encode(value, time), "\n"]
  @impl true
  def finish(_n), do: ""
  @impl true
  def start, do: nil

  @impl true
  def split(bytes, _state, last?, opts) do
    {lines, rest} = split_lines(bytes, last?)

    if byte_size(rest) > @max_line,
      do: {:error, "a line is longer than #{@max_line} bytes"},
      else: decode_lines(lines, rest, last?, opts, [])
  end

  defp split_lines(bytes, true), do: {String.split(bytes, "\n"), ""}

  defp split_lines(bytes, false) do
    {rest, lines} = bytes |> String.split("\n") |> List.pop_at(-1)
    {lines, rest}
  end

  defp decode_lines([], rest, _last?, _opts, messages),
    do: {:ok, Enum.reverse(messages), {rest, nil}}

  defp decode_lines([line | lines], rest, last?, opts, messages) do
    case {String.trim(line), lines} do
      {"", _} ->
        decode_lines(lines, rest, last?, opts, messages)

      {text, lines} ->
        case decode(text, opts) do
          {:ok, message} ->
            decode_lines(lines, rest, last?, opts, [message | messages])

          # A truncated last line has no line break.
          {:error, _} when last? and lines == [] ->
            {:ok, Enum.reverse(messages), {"", nil}}

          {:error, why} when messages == [] ->
            {:error, why}

          {:error, _} ->
            {:ok, Enum.reverse(messages), {Enum.join([line | lines] ++ [rest], "\n"), nil}}
        end
    end
  end
end
