defmodule Situ.Expression do
  @moduledoc """
  Parses and evaluates a small, safe language for values from messages, which derived streams and queries use.
  `docs/guides/expressions.md` describes the complete language.

      iex> {:ok, e} = Situ.Expression.parse("m.x * 2 + 1 > 10 and m.name != 'idle'")
      iex> Situ.Expression.eval(e, %{"m" => %{"x" => 5, "name" => "walk"}})
      true
      iex> {:ok, e} = Situ.Expression.parse("m.no.such.thing + 1")
      iex> Situ.Expression.eval(e, %{"m" => %{}})
      nil
      iex> {:error, error} = Situ.Expression.parse("m.x >")
      iex> error.why
      "at character 6: expected a value, found the end of the expression"

  It has no loops, assignments or side effects. An expression of `n` nodes (at most 1,000) is evaluated in `n`
  steps, each bounded by the size of its operands, and cannot fail. A part without a value is `nil` (`null`).
  """
  # See docs/adr/0093-expressions-are-a-total-language.md.
  alias Situ.Error
  alias Situ.Expression.{Functions, Parser, Operators}

  @enforce_keys [:source, :tree, :run]
  defstruct [:source, :tree, :run]

  @typedoc "`run` is the compiled form, a function of the environment."
  @type t :: %__MODULE__{source: String.t(), tree: tuple(), run: (env() -> term())}
  @typedoc "The values of the names."
  @type env :: %{String.t() => term()}

  @doc "Parses an expression. Error: `:bad_expression`, which names the position."
  @spec parse(String.t()) :: {:ok, t()} | {:error, Error.t()}
  def parse(source) when is_binary(source) do
    case Parser.parse(source) do
      {:ok, tree} ->
        {:ok, %__MODULE__{source: source, tree: tree, run: compile_tree(tree)}}

      {:error, at, why} ->
        {:error,
         Error.new(:bad_expression, "invalid expression #{inspect(source)}",
           why: "at character #{at}: #{why}",
           fix: "see docs/guides/expressions.md"
         )}
    end
  end

  @doc "Parses an expression, or raises the error."
  @spec parse!(String.t()) :: t()
  def parse!(source) do
    case parse(source) do
      {:ok, expression} -> expression
      {:error, error} -> raise error
    end
  end

  @doc "Evaluates an expression with the values in `env`; names that are missing there are `nil`."
  @spec eval(t(), env()) :: term()
  def eval(%__MODULE__{run: run}, env), do: run.(env)

  @doc """
  Returns the names that an expression uses, as they are spelled, without function names.

      iex> Situ.Expression.names(Situ.Expression.parse!("`Room.Level` > 3 and vad or latency(vad) > 500ms"))
      ["Room.Level", "vad"]
  """
  @spec names(t()) :: [String.t()]
  def names(%__MODULE__{tree: tree}), do: tree |> collect_names([]) |> Enum.uniq() |> Enum.sort()

  defp collect_names({:name, name}, names), do: [name | names]

  defp collect_names({:call, _, arguments}, names),
    do: Enum.reduce(arguments, names, &collect_names/2)

  defp collect_names({:list, items}, names), do: Enum.reduce(items, names, &collect_names/2)
  defp collect_names({:literal, _}, names), do: names
  defp collect_names({:member, of, _}, names), do: collect_names(of, names)
  defp collect_names({:unary, _, of}, names), do: collect_names(of, names)

  defp collect_names({_, _, left, right}, names),
    do: collect_names(right, collect_names(left, names))

  @doc """
  Evaluates an expression for each message of a stream. In it, `m` (or `value`) is the data, `time` and `created`
  are the times (ns), `latency` is their difference, and `sequence` is the sequence number. The messages keep their
  times. Option: `type:` of the output (`:any`).

      iex> double = fn p -> p |> Situ.from_enumerable([{1, 2}, {2, 5}]) |> Situ.Expression.map("m * 2") end
      iex> Situ.to_list(double, pipeline: [replay: [interval: {0, :unbounded}, speed: :max]])
      [4, 10]
  """
  @spec map(Situ.Stream.t(), String.t() | t(), keyword()) :: Situ.Stream.t()
  def map(stream, expression, opts \\ []) do
    %__MODULE__{run: run} = if is_binary(expression), do: parse!(expression), else: expression

    Situ.map(
      stream,
      fn _data, message -> run.(message_env(message)) end,
      Keyword.put_new(opts, :type, :any)
    )
  end

  @doc "Returns the names that an expression can use for a message."
  @spec message_env(Situ.Message.t()) :: env()
  def message_env(message) do
    %{
      "m" => message.data,
      "value" => message.data,
      "time" => message.originating_time,
      "created" => message.creation_time,
      "latency" => message.creation_time - message.originating_time,
      "sequence" => message.sequence_id
    }
  end

  # Compiles the tree to a function, so that it is not traversed again for each message.
  defp compile_tree({:literal, value}), do: fn _ -> value end
  defp compile_tree({:name, name}), do: fn env -> Map.get(env, name) end

  defp compile_tree({:list, items}) do
    items = Enum.map(items, &compile_tree/1)
    fn env -> Enum.map(items, & &1.(env)) end
  end

  defp compile_tree({:member, of, name}) do
    of = compile_tree(of)
    fn env -> Operators.get_member(of.(env), name) end
  end

  defp compile_tree({:index, _, of, index}) do
    {of, index} = {compile_tree(of), compile_tree(index)}
    fn env -> Operators.get_element(of.(env), index.(env)) end
  end

  defp compile_tree({:unary, operator, of}) do
    of = compile_tree(of)
    fn env -> Operators.apply_unary(operator, of.(env)) end
  end

  # The right operand is evaluated only if it matters.
  defp compile_tree({:binary, "and", left, right}) do
    {left, right} = {compile_tree(left), compile_tree(right)}
    fn env -> left.(env) == true and right.(env) == true end
  end

  defp compile_tree({:binary, "or", left, right}) do
    {left, right} = {compile_tree(left), compile_tree(right)}
    fn env -> left.(env) == true or right.(env) == true end
  end

  defp compile_tree({:binary, operator, left, right}) do
    {left, right} = {compile_tree(left), compile_tree(right)}
    fn env -> Operators.apply_binary(operator, left.(env), right.(env)) end
  end

  # In a query, the argument is the name of a stream and not its value.
  defp compile_tree({:call, name, [{:name, stream}]}) when name in ["latency", "age"] do
    key = "#{name}(#{stream})"
    fn env -> Map.get(env, key) end
  end

  defp compile_tree({:call, name, arguments}) do
    arguments = Enum.map(arguments, &compile_tree/1)
    fn env -> Functions.call(name, Enum.map(arguments, & &1.(env))) end
  end
end
