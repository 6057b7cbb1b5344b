defmodule Situ.Studio.Alerts.Rule do
  @moduledoc false
  # Parses alert rules. A rule is a name and an expression (`Situ.Expression`) over a pipeline's
  # streams and statistics. A stream's name refers to its latest value. `` `STATISTIC(PATH)` `` is
  # a statistic of a component, or the worst value among its incoming connections.
  # `Situ.Studio.PipelineView.Stats` lists the names.
  alias Situ.{Error, Expression}
  alias Situ.Studio.PipelineView.Stats

  @enforce_keys [:name, :expression]
  defstruct [:name, :expression]

  @type t :: %__MODULE__{name: String.t(), expression: Expression.t()}

  @most 50
  @bytes 8_000

  @doc """
  Parses rules of the form `NAME: EXPRESSION`, one per line; empty lines are ignored. Errors name
  the line.

      iex> text = "slow: `latency_mean(Screen)` > 200 or `Mic.Level` > 0.9"
      iex> {:ok, [rule]} = Situ.Studio.Alerts.Rule.parse_rules(text)
      iex> {rule.name, Situ.Studio.Alerts.Rule.referenced_streams(rule)}
      {"slow", ["Mic.Level"]}
      iex> Situ.Studio.Alerts.Rule.true?(rule, %{"latency_mean(Screen)" => 250.0, "Mic.Level" => nil})
      true
      iex> {:error, error} = Situ.Studio.Alerts.Rule.parse_rules("slow: `queue(Screen)` >")
      iex> error.what
      "line 1 is not an alert rule"
  """
  @spec parse_rules(String.t()) :: {:ok, [t()]} | {:error, Error.t()}
  def parse_rules(text) when byte_size(text) > @bytes, do: {:error, too_many()}

  def parse_rules(text) do
    lines =
      for {line, n} <- text |> String.split(~r/\R/) |> Enum.with_index(1),
          line = String.trim(line),
          line != "",
          do: {line, n}

    if length(lines) > @most, do: {:error, too_many()}, else: parse_lines(lines)
  end

  defp too_many do
    Error.new(:too_many, "there are too many alert rules",
      why: "the limit is #{@most} rules in #{@bytes} bytes",
      fix: "remove some rules"
    )
  end

  defp parse_lines(lines) do
    rules = Enum.map(lines, &parse_line/1)
    Enum.find(rules, {:ok, rules}, &match?({:error, _}, &1))
  end

  defp parse_line({line, n}) do
    with [name, text] <- String.split(line, ":", parts: 2),
         name when name != "" <- String.trim(name),
         {:ok, expression} <- Expression.parse(String.trim(text)),
         [_ | _] <- Expression.names(expression) do
      %__MODULE__{name: String.slice(name, 0, 60), expression: expression}
    else
      {:error, error} -> invalid_rule(n, "#{error.what}: #{error.why}")
      [] -> invalid_rule(n, "it does not name a stream or a statistic")
      _ -> invalid_rule(n, "a rule consists of a name, a colon and an expression")
    end
  end

  defp invalid_rule(n, why) do
    {:error,
     Error.new(:bad_rule, "line #{n} is not an alert rule",
       why: why,
       fix: "follow this example: busy: `queue(Slow.Heavy)` > 100"
     )}
  end

  @doc "Returns the statistics that the rule refers to, as `{name, statistic, path}`."
  @spec referenced_statistics(t()) :: [{String.t(), Stats.id(), String.t()}]
  def referenced_statistics(%__MODULE__{expression: expression}) do
    for name <- Expression.names(expression),
        [_, id, path] <- [Regex.run(~r/\A([a-z0-9_]+)\((.+)\)\z/u, name)],
        match?({:ok, _}, Stats.fetch(id)),
        do: {name, id, path}
  end

  @doc "Returns the names of the streams that the rule refers to."
  @spec referenced_streams(t()) :: [String.t()]
  def referenced_streams(%__MODULE__{expression: expression} = rule),
    do: Expression.names(expression) -- Enum.map(referenced_statistics(rule), &elem(&1, 0))

  @doc "Returns whether the rule is true for the values in `env`; an unknown value never makes a rule true."
  @spec true?(t(), Expression.env()) :: boolean()
  def true?(%__MODULE__{expression: expression}, env),
    do: Expression.eval(expression, env) == true
end
