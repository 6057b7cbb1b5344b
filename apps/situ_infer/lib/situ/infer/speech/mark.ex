defmodule Situ.Infer.Speech.Mark do
  @moduledoc """
  A part of spoken text, with the times of its beginning and end.

    * `kind`: `:sentence`, `:word`, `:phoneme` (its `text` in the International Phonetic Alphabet), or `:mark`, a place
      that the text names (`<mark name="here"/>` in SSML)
    * `text`: the sentence's, the word's, the sound's or the name
    * `from`, `to`: ns; from the beginning of the sound, or in a stream's time
    * `place`: of words and sentences, where in the text it stands, characters from 0
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
  Later by `ns`.

      iex> word = %Situ.Infer.Speech.Mark{kind: :word, text: "go", from: 0, to: 5}
      iex> Situ.Infer.Speech.Mark.shift(word, 100).to
      105
  """
  @spec shift(t(), integer()) :: t()
  def shift(%__MODULE__{} = mark, ns), do: %{mark | from: mark.from + ns, to: mark.to + ns}
end
