defmodule Situ.Infer.Speech.Espeak.OutputParser do
  @moduledoc false
  # Parses the output of the program `situ_speak`: audio, and marks of sentences, words and
  # phonemes. Pure.
  #
  # A frame consists of a tag, the size of the payload (32 bits, little endian), and the payload.
  # The tags are listed in `native/situ_speak/src/main.rs`.
  alias Situ.{AudioBuffer, AudioFormat}
  alias Situ.Infer.Speech.Mark

  @doc """
  Returns the audio and the marks, or `:error` if the bytes are truncated or have a different
  format.

      iex> bytes = <<"r", 4::little-32, 1000::little-32, "w", 12::little-32, 1::little-32, 3::little-32, 2::little-32,
      ...>   "a", 4::little-32, 0::32>>
      iex> {:ok, sound, [word]} = Situ.Infer.Speech.Espeak.OutputParser.parse(bytes, "So go")
      iex> {Situ.AudioBuffer.frame_count(sound), word.text, word.from, word.to}
      {2, "go", 1_000_000, 2_000_000}
  """
  @spec parse(binary(), String.t()) :: {:ok, AudioBuffer.t(), [Mark.t()]} | :error
  def parse(<<"r", 4::little-32, rate::little-32, rest::binary>>, text)
      when rate in 1..1_000_000 do
    with {:ok, sound, events} <- parse_frames(rest, [], []) do
      format = AudioFormat.pcm(rate)
      sound = AudioBuffer.new!(format: format, data: IO.iodata_to_binary(sound))

      {:ok, sound,
       build_marks(events, AudioBuffer.frame_count(sound), rate, String.graphemes(text))}
    end
  end

  def parse(_, _text), do: :error

  defp parse_frames(<<>>, sound, events), do: {:ok, Enum.reverse(sound), Enum.reverse(events)}

  defp parse_frames(
         <<tag, size::little-32, payload::binary-size(size), rest::binary>>,
         sound,
         events
       ) do
    case {tag, payload} do
      {?a, samples} when rem(size, 2) == 0 ->
        parse_frames(rest, [samples | sound], events)

      {tag, <<at::little-32, offset::little-32, length::little-32>>} when tag in ~c"ws" ->
        kind = if tag == ?w, do: :word, else: :sentence
        parse_frames(rest, sound, [{kind, at, {offset, length}} | events])

      {?p, <<at::little-32, name::binary>>} ->
        parse_frames(rest, sound, [{:phoneme, at, name} | events])

      {?m, <<at::little-32, name::binary>>} ->
        parse_frames(rest, sound, [{:mark, at, name} | events])

      _ ->
        :error
    end
  end

  defp parse_frames(_, _sound, _events), do: :error

  # Each mark lasts until the next mark of its kind. A word also ends at a pause.
  defp build_marks([], _frames, _rate, _text), do: []

  defp build_marks([{kind, at, what} | later], frames, rate, text) do
    ends =
      Enum.find_value(later, frames, fn event -> ends_mark?(kind, event, at) && elem(event, 1) end)

    ns = &div(&1 * 1_000_000_000, rate)
    # The library may report marks after the end of the audio; they are moved to its end.
    {from, to} = {min(at, frames), min(max(ends, at), frames)}
    rest = build_marks(later, frames, rate, text)

    case build_mark(kind, what, text, to) do
      nil -> rest
      mark when kind == :mark -> [%{mark | from: ns.(from), to: ns.(from)} | rest]
      mark -> [%{mark | from: ns.(from), to: ns.(to)} | rest]
    end
  end

  defp ends_mark?(kind, {kind, _, _}, _at), do: true
  # The phonemes of a word follow its mark; an empty phoneme is silence and ends the word.
  defp ends_mark?(:word, {:phoneme, at, ""}, from), do: at > from
  defp ends_mark?(_kind, _event, _at), do: false

  defp build_mark(:phoneme, "", _text, _to), do: nil

  defp build_mark(kind, name, _text, _to) when is_binary(name) do
    if String.valid?(name), do: %Mark{kind: kind, text: name, from: 0, to: 0}
  end

  defp build_mark(:word, {offset, length}, text, _to) do
    word = text |> Enum.slice(offset, length) |> Enum.join()
    %Mark{kind: :word, text: word, place: offset, from: 0, to: 0}
  end

  defp build_mark(:sentence, {offset, _length}, _text, _to),
    do: %Mark{kind: :sentence, text: "", place: offset, from: 0, to: 0}
end
