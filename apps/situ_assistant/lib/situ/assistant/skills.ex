defmodule Situ.Assistant.Skills do
  @moduledoc false
  # The assistant's built-in skills: it reports the time and the date, sets and cancels timers,
  # and stops talking. Pure: replies and actions depend only on the intent and the time.
  alias Situ.Infer.Speech.Number
  alias Situ.Intent

  @grammar """
  #JSGF V1.0;
  grammar assistant;
  public <time> = (what time is it | what is the time | what's the time | tell me the time) [now] {intent=time};
  public <date> = (what day is it | what day is today | what is the date | what's the date | what date is it) [today]
                  {intent=date};
  public <timer> = ((set | start | make) (a | the | another) timer | [setter | start a] timer)
                   {intent=timer} (for | of | to | in) <length>
                 | (wake | remind | call) me {intent=timer} in <length>
                 | (set | start | make) (a | the) {intent=timer} <length> timer;
  <length> = <NUMBER> {count} (second | seconds | minute | minutes | hour | hours) {unit};
  public <cancel> = (cancel | delete | forget | stop) (the | my | all) (timer | timers) {intent=cancel};
  public <stop> = (stop | be quiet | quiet | never mind | that is enough) {intent=stop};
  public <thanks> = (thank you | thanks) {intent=thanks};
  """

  @units %{"second" => 1, "minute" => 60, "hour" => 3_600}
  @days ~w(Monday Tuesday Wednesday Thursday Friday Saturday Sunday)
  @months ~w(January February March April May June July August September October November December)
  @ordinals ~w(first second third fourth fifth sixth seventh eighth ninth tenth eleventh twelfth thirteenth fourteenth
               fifteenth sixteenth seventeenth eighteenth nineteenth twentieth)

  @type action ::
          {:say, String.t()}
          | {:timer, Situ.Time.duration(), length :: String.t(), String.t()}
          | :cancel
          | :quiet
          | :unknown

  @doc """
  Returns the grammar of the sentences that these skills understand.

      iex> {:ok, grammar} = Situ.Intent.Grammar.load(grammar: Situ.Assistant.Skills.grammar())
      iex> {:ok, intent} = Situ.Intent.Grammar.detect(grammar, "set a timer for five minutes")
      iex> Situ.Assistant.Skills.answer_intent(intent, {{2026, 11, 22}, {11, 5, 0}})
      {:timer, 300_000_000_000, "five minutes", "I set a timer for five minutes."}
  """
  @spec grammar() :: String.t()
  def grammar, do: @grammar

  @doc "Returns the reply or action for an intent when the local time is `now`."
  @spec answer_intent(Intent.t(), :calendar.datetime()) :: action()
  def answer_intent(%Intent{} = intent, now) do
    case Intent.name(intent) do
      "time" -> {:say, time_in_words(now)}
      "date" -> {:say, date_in_words(now)}
      "timer" -> timer_action(intent)
      "cancel" -> :cancel
      "stop" -> :quiet
      "thanks" -> {:say, "You are welcome."}
      _ -> :unknown
    end
  end

  defp timer_action(intent) do
    with count when is_binary(count) <- Intent.entity(intent, "count"),
         unit when is_binary(unit) <- Intent.entity(intent, "unit"),
         n when n > 0 <- String.to_integer(count) do
      unit = String.trim_trailing(unit, "s")
      length = "#{Number.to_words(n)} #{unit}#{if n > 1, do: "s"}"

      {:timer, n * Map.fetch!(@units, unit) * 1_000_000_000, length,
       "I set a timer for #{length}."}
    else
      _ -> {:say, "For how long?"}
    end
  end

  @doc """
  Formats the time in words.

      iex> Situ.Assistant.Skills.time_in_words({{2026, 11, 22}, {9, 5, 0}})
      "It is nine oh five."
      iex> Situ.Assistant.Skills.time_in_words({{2026, 11, 22}, {0, 0, 59}})
      "It is midnight."
  """
  @spec time_in_words(:calendar.datetime()) :: String.t()
  def time_in_words({_, {0, 0, _}}), do: "It is midnight."
  def time_in_words({_, {12, 0, _}}), do: "It is noon."
  def time_in_words({_, {hour, 0, _}}), do: "It is #{Number.to_words(hour)} o'clock."

  def time_in_words({_, {hour, minute, _}}) when minute < 10,
    do: "It is #{Number.to_words(hour)} oh #{Number.to_words(minute)}."

  def time_in_words({_, {hour, minute, _}}),
    do: "It is #{Number.to_words(hour)} #{Number.to_words(minute)}."

  @doc """
  Formats the date in words.

      iex> Situ.Assistant.Skills.date_in_words({{2026, 11, 22}, {9, 5, 0}})
      "It is Sunday, November the twenty second."
  """
  @spec date_in_words(:calendar.datetime()) :: String.t()
  def date_in_words({{_, month, day} = date, _}) do
    name = Enum.at(@days, :calendar.day_of_the_week(date) - 1)
    "It is #{name}, #{Enum.at(@months, month - 1)} the #{ordinal_in_words(day)}."
  end

  defp ordinal_in_words(day) when day <= 20, do: Enum.at(@ordinals, day - 1)
  defp ordinal_in_words(30), do: "thirtieth"

  defp ordinal_in_words(day),
    do: "#{Number.to_words(10 * div(day, 10))} #{ordinal_in_words(rem(day, 10))}"
end
