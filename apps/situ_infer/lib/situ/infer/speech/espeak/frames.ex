defmodule Situ.Infer.Speech.Espeak.Frames do
  @moduledoc """
  Reads what the program `situ_speak` writes: sound, and marks of sentences, words and sounds. Pure.

  A frame is a tag, the size of what follows (32 bits, little endian), and that; the tags are listed in
  `native/situ_speak/src/main.rs`.

      iex> bytes = <<"r", 4::little-32, 1000::little-32, "w", 12::little-32, 1::little-32, 3::little-32, 2::little-32,
      ...>   "a", 4::little-32, 0::32>>
      iex> {:ok, sound, [word]} = Situ.Infer.Speech.Espeak.Frames.parse(bytes, "So go")
      iex> {Situ.AudioBuffer.frames(sound), word.text, word.from, word.to}
      {2, "go", 1_000_000, 2_000_000}
  """
  alias Situ.{AudioBuffer, AudioFormat}
  alias Situ.Infer.Speech.Mark

  @doc "The sound and marks; `:error` when the bytes are cut short or of another kind."
  @spec parse(binary(), String.t()) :: {:ok, AudioBuffer.t(), [Mark.t()]} | :error
  def parse(<<"r", 4::little-32, rate::little-32, rest::binary>>, text)
      when rate in 1..1_000_000 do
    with {:ok, sound, events} <- frames(rest, [], []) do
      format = AudioFormat.pcm(rate)
      sound = AudioBuffer.new!(format: format, data: IO.iodata_to_binary(sound))
      {:ok, sound, marks(events, AudioBuffer.frames(sound), rate, String.graphemes(text))}
    end
  end

  def parse(_, _text), do: :error

  defp frames(<<>>, sound, events), do: {:ok, Enum.reverse(sound), Enum.reverse(events)}

  defp frames(<<tag, size::little-32, payload::binary-size(size), rest::binary>>, sound, events) do
    case {tag, payload} do
      {?a, samples} when rem(size, 2) == 0 ->
        frames(rest, [samples | sound], events)

      {tag, <<at::little-32, place::little-32, length::little-32>>} when tag in ~c"ws" ->
        kind = if tag == ?w, do: :word, else: :sentence
        frames(rest, sound, [{kind, at, {place, length}} | events])

      {?p, <<at::little-32, name::binary>>} ->
        frames(rest, sound, [{:phoneme, at, name} | events])

      {?m, <<at::little-32, name::binary>>} ->
        frames(rest, sound, [{:mark, at, name} | events])

      _ ->
        :error
    end
  end

  defp frames(_, _sound, _events), do: :error

  # Each lasts to the next of its kind; a word also ends where a pause begins.
  defp marks([], _frames, _rate, _text), do: []

  defp marks([{kind, at, what} | later], frames, rate, text) do
    ends =
      Enum.find_value(later, frames, fn event -> ends?(kind, event, at) && elem(event, 1) end)

    ns = &div(&1 * 1_000_000_000, rate)
    # The library may report marks behind the end of the sound; they go to its end.
    {from, to} = {min(at, frames), min(max(ends, at), frames)}
    rest = marks(later, frames, rate, text)

    case mark(kind, what, text, to) do
      nil -> rest
      mark when kind == :mark -> [%{mark | from: ns.(from), to: ns.(from)} | rest]
      mark -> [%{mark | from: ns.(from), to: ns.(to)} | rest]
    end
  end

  defp ends?(kind, {kind, _, _}, _at), do: true
  # The sounds of a word are named after it; silence among them is its end.
  defp ends?(:word, {:phoneme, at, ""}, from), do: at > from
  defp ends?(_kind, _event, _at), do: false

  defp mark(:phoneme, "", _text, _to), do: nil

  defp mark(kind, name, _text, _to) when is_binary(name) do
    if String.valid?(name), do: %Mark{kind: kind, text: name, from: 0, to: 0}
  end

  defp mark(:word, {place, length}, text, _to) do
    word = text |> Enum.slice(place, length) |> Enum.join()
    %Mark{kind: :word, text: word, place: place, from: 0, to: 0}
  end

  defp mark(:sentence, {place, _length}, _text, _to),
    do: %Mark{kind: :sentence, text: "", place: place, from: 0, to: 0}
end
