defmodule Situ.Bridge.Format.JsonLines do
  @moduledoc false
  # Encodes each message as one line of JSON.
  @behaviour Situ.Bridge.Format
  alias Situ.Bridge.Format.Json

  @most 64 * 1024 * 1024

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

    cond do
      byte_size(rest) > @most -> {:error, "a line is longer than #{@most} bytes"}
      true -> decode_lines(lines, rest, last?, opts, [])
    end
  end

  defp split_lines(bytes, true), do: {String.split(bytes, "\n"), ""}

  defp split_lines(bytes, false) do
    {rest, lines} =
      bytes |> String.split("\n") |> List.pop_at(-1) |> then(fn {r, l} -> {r, l} end)

    {lines, rest}
  end

  defp decode_lines([], rest, _last?, _opts, found), do: {:ok, Enum.reverse(found), {rest, nil}}

  defp decode_lines([line | lines], rest, last?, opts, found) do
    case {String.trim(line), lines} do
      {"", _} ->
        decode_lines(lines, rest, last?, opts, found)

      {text, lines} ->
        case decode(text, opts) do
          {:ok, timed} ->
            decode_lines(lines, rest, last?, opts, [timed | found])

          # A truncated last line has no line break.
          {:error, _} when last? and lines == [] ->
            {:ok, Enum.reverse(found), {"", nil}}

          {:error, why} when found == [] ->
            {:error, why}

          {:error, _} ->
            {:ok, Enum.reverse(found), {Enum.join([line | lines] ++ [rest], "\n"), nil}}
        end
    end
  end
end
