defmodule Situ.Examples.SpeakerLabels do
  @moduledoc """
  Labels the face of the current speaker with the spoken words, like subtitles attributed to a speaker.

  Input `:faces` is `{mouths, speaking}` for every image (`Situ.Infer.MouthShape`, `Situ.Infer.who_speaks/3`), and
  `:said` contains the utterances. For each image during an utterance, output `:out` contains the speaker's rectangle,
  labeled with a few of the words, or an empty list if the speaker is outside the image.
  """
  use Situ.Component,
    inputs: [
      faces: {:tuple, [{:map, :any, Situ.Infer.Mouth}, {:map, :any, :boolean}]},
      said: Situ.Infer.Speech.Utterance
    ],
    outputs: [out: {:list, Situ.Rect}]

  alias Situ.Examples.Demo.Transcript

  # The maximum number of words in a label.
  @at_once 6
  # Images wait this long for their utterance. This exceeds the length of any utterance plus the recognition time.
  @patience 60_000_000_000

  defstruct pictures: [], said: []

  @type t :: %__MODULE__{}

  @impl true
  def init(_opts), do: {:ok, %__MODULE__{}}

  @impl true
  def handle_message(:faces, %{data: {mouths, speaking}, originating_time: time}, _context, state) do
    faces =
      for {id, speaks?} <- speaking, mouth = mouths[id], mouth.rect, do: {mouth.rect, speaks?}

    waiting = Enum.take_while(state.pictures, fn {t, _} -> time - t < @patience end)
    emit_utterances(%{state | pictures: [{time, faces} | waiting]})
  end

  def handle_message(:said, %{data: said}, _context, state),
    do: emit_utterances(%{state | said: state.said ++ [said]})

  @impl true
  def handle_closed(:faces, _time, _context, %{pictures: pictures} = state) when pictures != [],
    do: emit_utterances(%{state | pictures: [{:infinity, []} | pictures]})

  def handle_closed(_input, _time, _context, state), do: {[], state}

  # An utterance is emitted once an image after its end has arrived.
  defp emit_utterances(%{said: [said | others], pictures: [{newest, _} | _] = pictures} = state)
       when newest > said.to do
    {after_it, rest} = Enum.split_while(pictures, fn {time, _} -> time > said.to end)
    found = rest |> Enum.take_while(fn {time, _} -> time >= said.from end) |> Enum.reverse()
    {more, state} = emit_utterances(%{state | said: others, pictures: after_it})
    {label_speaker(said, found) ++ more, state}
  end

  defp emit_utterances(state), do: {[], state}

  defp label_speaker(said, found) do
    speaker = Transcript.find_speaker(said, found)

    for {time, faces} <- found do
      seen =
        for {rect, _} <- faces,
            speaker != nil,
            rect.id == speaker.id,
            do: %{rect | label: words_at(said, time), score: nil}

      {:out, time, seen}
    end
  end

  @doc """
  Returns the words of an utterance around a time, as if all words were equally long.

      iex> alias Situ.Infer.Speech.Utterance
      iex> said = %Utterance{text: "One two three four five six seven.", from: 0, to: 700, confidence: 1.0}
      iex> {Situ.Examples.SpeakerLabels.words_at(said, 10), Situ.Examples.SpeakerLabels.words_at(said, 650)}
      {"One two three four", "five six seven."}
  """
  @spec words_at(Situ.Infer.Speech.Utterance.t(), Situ.Time.t()) :: String.t()
  def words_at(said, time) do
    words = String.split(said.text)
    rows = max(ceil(length(words) / @at_once), 1)
    rows = Enum.chunk_every(words, max(ceil(length(words) / rows), 1))
    share = (time - said.from) / max(said.to - said.from, 1)
    rows |> Enum.at(min(trunc(share * length(rows)), length(rows) - 1), []) |> Enum.join(" ")
  end
end
