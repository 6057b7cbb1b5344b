defmodule Situ.Studio.Alerts.Rule do
  @moduledoc """
  A rule of an alert: a name and an expression (`Situ.Expression`) over a running pipeline's streams and statistics. A
  stream's name refers to its latest value. `` `STATISTIC(PATH)` `` is a statistic of a component, or the worst value
  among its incoming connections. `Situ.Studio.PipelineView.Stats` lists the names.

      iex> {:ok, [rule]} = Situ.Studio.Alerts.Rule.read("slow: `latency_mean(Screen)` > 200 or `Mic.Level` > 0.9")
      iex> {rule.name, Situ.Studio.Alerts.Rule.streams(rule)}
      {"slow", ["Mic.Level"]}
      iex> Situ.Studio.Alerts.Rule.true?(rule, %{"latency_mean(Screen)" => 250.0, "Mic.Level" => nil})
      true
      iex> {:error, error} = Situ.Studio.Alerts.Rule.read("slow: `queue(Screen)` >")
      iex> error.what
      "line 1 is not an alert rule"
  """
  alias Situ.{Error, Expression}
  alias Situ.Studio.PipelineView.Stats

  @enforce_keys [:name, :expression]
  defstruct [:name, :expression]

  @type t :: %__MODULE__{name: String.t(), expression: Expression.t()}

  @most 50
  @bytes 8_000

  @doc "Parses rules of the form `NAME: EXPRESSION`, one per line; empty lines are ignored. Errors name the line."
  @spec read(String.t()) :: {:ok, [t()]} | {:error, Error.t()}
  def read(text) when byte_size(text) > @bytes, do: {:error, too_many()}

  def read(text) do
    lines =
      for {line, n} <- text |> String.split(~r/\R/) |> Enum.with_index(1),
          line = String.trim(line),
          line != "",
          do: {line, n}

    if length(lines) > @most, do: {:error, too_many()}, else: each(lines)
  end

  defp too_many do
    Error.new(:too_many, "there are too many alert rules",
      why: "the limit is #{@most} rules in #{@bytes} bytes",
      fix: "remove some rules"
    )
  end

  defp each(lines) do
    rules = Enum.map(lines, &rule/1)
    Enum.find(rules, {:ok, rules}, &match?({:error, _}, &1))
  end

  defp rule({line, n}) do
    with [name, text] <- String.split(line, ":", parts: 2),
         name when name != "" <- String.trim(name),
         {:ok, expression} <- Expression.parse(String.trim(text)),
         [_ | _] <- Expression.names(expression) do
      %__MODULE__{name: String.slice(name, 0, 60), expression: expression}
    else
      {:error, error} -> bad(n, "#{error.what}: #{error.why}")
      [] -> bad(n, "it does not name a stream or a statistic")
      _ -> bad(n, "a rule consists of a name, a colon and an expression")
    end
  end

  defp bad(n, why) do
    {:error,
     Error.new(:bad_rule, "line #{n} is not an alert rule",
       why: why,
       fix: "follow this example: busy: `queue(Slow.Heavy)` > 100"
     )}
  end

  @doc "Returns the statistics that the rule refers to, as `{name, statistic, path}`."
  @spec statistics(t()) :: [{String.t(), Stats.id(), String.t()}]
  def statistics(%__MODULE__{expression: expression}) do
    for name <- Expression.names(expression),
        [_, id, path] <- [Regex.run(~r/\A([a-z0-9_]+)\((.+)\)\z/u, name)],
        match?({:ok, _}, Stats.fetch(id)),
        do: {name, id, path}
  end

  @doc "Returns the names of the streams that the rule refers to."
  @spec streams(t()) :: [String.t()]
  def streams(%__MODULE__{expression: expression} = rule),
    do: Expression.names(expression) -- Enum.map(statistics(rule), &elem(&1, 0))

  @doc "Returns whether the rule is true for the values in `env`; an unknown value never makes a rule true."
  @spec true?(t(), Expression.env()) :: boolean()
  def true?(%__MODULE__{expression: expression}, env),
    do: Expression.eval(expression, env) == true
end
