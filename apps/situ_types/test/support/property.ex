defmodule Situ.Test.Property do
  @moduledoc """
  Property tests for ExUnit, run by PropEr (Debian's `erlang-proper`).

      defmodule MyTest do
        use ExUnit.Case, async: true
        use Situ.Test.Property

        property "reversing twice changes nothing" do
          forall xs <- list(integer()) do
            assert Enum.reverse(Enum.reverse(xs)) == xs
          end
        end
      end

  The body may use `assert` and similar macros. An input is a counterexample if the body raises or returns `false`;
  any other result passes. A failure shows the shrunk input and the error that it caused. Combine several inputs in a
  tuple: `forall {a, b} <- {integer(), boolean()}`.

  Options of `property`: `numtests:` (default 100), `max_size:` (default 42, as in PropEr), and `context: pattern` to
  match the ExUnit context. `use` also imports the generators of `Situ.Test.Generators`.

  `SITU_TIMES=20 mix test` tries twenty times as many inputs, to search for rare counterexamples. The inputs depend on
  ExUnit's seed, so `mix test --seed 1234` repeats them.

  Only test code may use this module, because applications do not start or ship `:proper`.
  """

  @doc false
  defmacro __using__(_opts) do
    quote do
      import Situ.Test.Property, only: [property: 2, property: 3, forall: 2]
      import Situ.Test.Generators
    end
  end

  @doc "Defines an ExUnit test that checks the `forall` at the end of its body."
  defmacro property(name, opts \\ [], do: body) do
    {context, opts} = Keyword.pop(opts, :context, Macro.var(:_, nil))

    quote do
      test unquote(name), unquote(context) do
        Situ.Test.Property.check_forall(unquote(body), unquote(opts))
      end
    end
  end

  @doc "Builds a property that runs the body with every generated value."
  defmacro forall({:<-, _, [pattern, generator]}, do: body) do
    quote do
      {unquote(generator), fn unquote(pattern) -> unquote(body) end}
    end
  end

  @doc """
  Checks `{generator, fun}` and raises `ExUnit.AssertionError` with the shrunk counterexample.

      iex> Situ.Test.Property.check_forall({Situ.Test.Generators.integer(), fn n -> n + 0 == n end}, numtests: 20)
      :ok
  """
  @spec check_forall({term(), (term() -> term())}, keyword()) :: :ok
  def check_forall({generator, fun}, opts \\ []) do
    flags = [
      :quiet,
      :long_result,
      {:numtests, Keyword.get(opts, :numtests, 100) * Situ.Test.Budget.repeat_factor()},
      {:max_size, Keyword.get(opts, :max_size, 42)}
    ]

    # PropEr uses the random number generator of the current process, so seed it here.
    :rand.seed(:exsplus, {ExUnit.configuration()[:seed] || 0, 0, 0})

    case :proper.quickcheck(:proper.forall(generator, &holds_for?(fun, &1)), flags) do
      true ->
        :ok

      {:error, reason} ->
        raise_failure("the property could not be checked: #{inspect(reason)}", [])

      [input | _] ->
        raise_counterexample(fun, input)
    end
  end

  defp holds_for?(fun, input) do
    fun.(input) != false
  rescue
    _ -> false
  end

  # Runs the property again, because the first error belongs to the input before shrinking.
  @spec raise_counterexample((term() -> term()), term()) :: no_return()
  defp raise_counterexample(fun, input) do
    shown = "input: " <> inspect(input, charlists: :as_lists, limit: 200, pretty: true)

    try do
      fun.(input)
    rescue
      error ->
        raise_failure("#{shown}\n\n#{Exception.format(:error, error)}", __STACKTRACE__)
    else
      false ->
        raise_failure("#{shown}\n\nthe property returned false", [])

      _ ->
        raise_failure(
          "#{shown}\n\nit failed, then passed with the same input: it depends on more than its input",
          []
        )
    end
  end

  defp raise_failure(message, stacktrace) do
    error = struct!(ExUnit.AssertionError, message: "property does not hold\n" <> message)
    :erlang.raise(:error, error, stacktrace)
  end
end
