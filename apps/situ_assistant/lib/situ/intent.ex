defmodule Situ.Intent do
  @moduledoc """
  The intent of a sentence: its text (`query`), the possible `intents` (best first, each with a score of 0..1), and
  the `entities` in it (`minutes` 5, `name` "tea").

      iex> {:ok, grammar} = Situ.Intent.Grammar.load(grammar: \"""
      ...> #JSGF V1.0; grammar kitchen;
      ...> public <timer> = (set | start) [a | the] timer {intent=timer} [for <NUMBER> {minutes} minutes];
      ...> \""")
      iex> {:ok, intent} = Situ.Intent.Grammar.detect(grammar, "Please, set a timer for twenty five minutes!")
      iex> {Situ.Intent.name(intent), Situ.Intent.entity(intent, "minutes")}
      {"timer", "25"}

  `Situ.Intent.Grammar` detects intents with a grammar, and `Situ.Intent.LanguageModel` with a language model. On
  streams, use `Situ.Intent.Detector` with either of them.
  """

  @enforce_keys [:query]
  defstruct [:query, intents: [], entities: []]

  @type intent :: %{value: String.t(), score: float()}
  @type entity :: %{type: String.t(), value: String.t(), score: float()}
  @type t :: %__MODULE__{query: String.t(), intents: [intent()], entities: [entity()]}

  @doc "Returns the likeliest intent, or `nil`."
  @spec name(t()) :: String.t() | nil
  def name(%__MODULE__{intents: []}), do: nil
  def name(%__MODULE__{intents: [best | _]}), do: best.value

  @doc "Returns the value of the first entity of this type, or `nil`."
  @spec entity(t(), String.t()) :: String.t() | nil
  def entity(%__MODULE__{entities: entities}, type),
    do: Enum.find_value(entities, &(&1.type == type && &1.value))

  @doc """
  Formats the intent as one line of text.

      iex> Situ.Intent.format(%Situ.Intent{query: "what time is it", intents: [%{value: "time", score: 1.0}]})
      "time: \\"what time is it\\""
  """
  @spec format(t()) :: String.t()
  def format(%__MODULE__{} = intent) do
    entities = for e <- intent.entities, do: ", #{e.type} #{e.value}"
    "#{name(intent) || "?"}#{entities}: #{inspect(intent.query)}"
  end
end
