defmodule Situ.Infer.Speech.Mark do
  @moduledoc """
  A part of spoken text, with its start and end times.

    * `kind`: `:sentence`, `:word`, `:phoneme` (its `text` is in the International Phonetic Alphabet), or `:mark`, a
      position named in the text (`<mark name="here"/>` in SSML)
    * `text`: the sentence, word, phoneme or name
    * `from`, `to`: ns; from the start of the audio, or in a stream's time
    * `place`: the offset of words and sentences in the text, in characters from 0
  """
  @enforce_keys [:kind, :text, :from, :to]
  defstruct [:kind, :text, :from, :to, :place]

  @type t :: %__MODULE__{
          kind: :sentence | :word | :phoneme | :mark,
          text: String.t(),
          from: Situ.Time.t(),
          to: Situ.Time.t(),
          place: non_neg_integer() | nil
        }

  @doc """
  Shifts a mark by `ns`.

      iex> word = %Situ.Infer.Speech.Mark{kind: :word, text: "go", from: 0, to: 5}
      iex> Situ.Infer.Speech.Mark.shift(word, 100).to
      105
  """
  @spec shift(t(), integer()) :: t()
  def shift(%__MODULE__{} = mark, ns), do: %{mark | from: mark.from + ns, to: mark.to + ns}
end
