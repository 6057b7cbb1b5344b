defmodule Situ.Chat.History do
  @moduledoc false
  # Stores the conversation so far: the most recent questions with their answers. Pure.
  alias Situ.Chat.{Answer, Turn}
  alias Situ.Error

  defstruct [:capacity, turns: []]
  @type t :: %__MODULE__{capacity: non_neg_integer(), turns: [[Turn.t()]]}

  @spec new(non_neg_integer()) :: t()
  def new(capacity), do: %__MODULE__{capacity: capacity}

  @doc "Converts the component's input to turns."
  @spec parse_turns(term()) :: {:ok, [Turn.t()]} | {:error, Error.t()}
  def parse_turns(text) when is_binary(text) do
    if String.valid?(text), do: {:ok, [Turn.user(text)]}, else: bad_question(text)
  end

  def parse_turns(%Turn{} = turn), do: parse_turns([turn])

  def parse_turns([%Turn{} | _] = turns) do
    if Enum.all?(turns, &(is_struct(&1, Turn) and String.valid?(&1.text))),
      do: {:ok, turns},
      else: bad_question(turns)
  end

  def parse_turns(other), do: bad_question(other)

  defp bad_question(value) do
    {:error,
     Error.new(:bad_question, "not a question: #{inspect(value, limit: 5, printable_limit: 40)}",
       fix: "pass UTF-8 text, a Situ.Chat.Turn, or a list of turns"
     )}
  end

  @doc "Appends the turns to the earlier ones. A whole conversation as input replaces the earlier turns."
  @spec with_history(t(), [Turn.t()]) :: [Turn.t()]
  def with_history(%__MODULE__{} = memory, [_] = turns),
    do: memory.turns |> Enum.reverse([turns]) |> Enum.concat()

  def with_history(_memory, turns), do: turns

  @doc "Adds a question and its answer."
  @spec add_exchange(t(), [Turn.t()], Answer.t()) :: t()
  def add_exchange(
        %__MODULE__{} = memory,
        [%Turn{images: images} = turn],
        %Answer{calls: []} = answer
      ) do
    # Images are sent only once.
    turn = if images == [], do: turn, else: %{turn | images: []}

    %{
      memory
      | turns: Enum.take([[turn, Turn.assistant(answer.text)] | memory.turns], memory.capacity)
    }
  end

  def add_exchange(memory, _turns, _answer), do: memory
end
