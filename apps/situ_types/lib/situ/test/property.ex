defmodule Situ.Test.Property do
  @moduledoc """
  Property tests in ExUnit, run by PropEr (Debian's `erlang-proper`).

      defmodule MyTest do
        use ExUnit.Case, async: true
        use Situ.Test.Property

        property "reversing twice changes nothing" do
          forall xs <- list(integer()) do
            assert Enum.reverse(Enum.reverse(xs)) == xs
          end
        end
      end

  The body may use `assert` and friends; a body that raises is a counterexample, and so is one that returns `false` (any
  other value passes). A failure shows the input after shrinking and the error that it caused. Several inputs are a
  tuple: `forall {a, b} <- {integer(), boolean()}`.

  Options of `property`: `numtests:` (default 100), `max_size:` (default 42, PropEr's own), `context: pattern` to
  match the ExUnit context. Generators are those of `Situ.Test.Gen`, which `use` imports.

  `SITU_TIMES=20 mix test` tries every property twenty times as often: a search for rare counterexamples. The inputs
  follow from ExUnit's seed: `mix test --seed 1234` tries the same ones again.

  Only test code may call this: `:proper` is not started or shipped with an application.
  """

  @doc false
  defmacro __using__(_opts) do
    quote do
      import Situ.Test.Property, only: [property: 2, property: 3, forall: 2]
      import Situ.Test.Gen
    end
  end

  @doc "Defines an ExUnit test that checks the `forall` which its body ends in."
  defmacro property(name, opts \\ [], do: body) do
    {context, opts} = Keyword.pop(opts, :context, Macro.var(:_, nil))

    quote do
      test unquote(name), unquote(context) do
        Situ.Test.Property.check(unquote(body), unquote(opts))
      end
    end
  end

  @doc "A property: the body for every value of the generator."
  defmacro forall({:<-, _, [pattern, generator]}, do: body) do
    quote do
      {unquote(generator), fn unquote(pattern) -> unquote(body) end}
    end
  end

  @doc """
  Checks `{generator, fun}` and raises `ExUnit.AssertionError` with the shrunk counterexample.

      iex> Situ.Test.Property.check({Situ.Test.Gen.integer(), fn n -> n + 0 == n end}, numtests: 20)
      :ok
  """
  @spec check({term(), (term() -> term())}, keyword()) :: :ok
  def check({generator, fun}, opts \\ []) do
    flags = [
      :quiet,
      :long_result,
      {:numtests, Keyword.get(opts, :numtests, 100) * Situ.Test.Budget.times()},
      {:max_size, Keyword.get(opts, :max_size, 42)}
    ]

    # PropEr continues with the random numbers of its process.
    :rand.seed(:exsplus, {ExUnit.configuration()[:seed] || 0, 0, 0})

    case :proper.quickcheck(:proper.forall(generator, &holds?(fun, &1)), flags) do
      true -> :ok
      {:error, reason} -> fail("the property could not be checked: #{inspect(reason)}", [])
      [input | _] -> explain(fun, input)
    end
  end

  defp holds?(fun, input) do
    fun.(input) != false
  rescue
    _ -> false
  end

  # Run once more, to show the error of the shrunk input and not that of the first one found.
  @spec explain((term() -> term()), term()) :: no_return()
  defp explain(fun, input) do
    shown = "input: " <> inspect(input, charlists: :as_lists, limit: 200, pretty: true)

    try do
      fun.(input)
    rescue
      error ->
        fail("#{shown}\n\n#{Exception.format(:error, error)}", __STACKTRACE__)
    else
      false ->
        fail("#{shown}\n\nthe property returned false", [])

      _ ->
        fail(
          "#{shown}\n\nfailed once, then held: the property depends on more than its input",
          []
        )
    end
  end

  defp fail(message, stacktrace) do
    error = struct!(ExUnit.AssertionError, message: "property does not hold\n" <> message)
    :erlang.raise(:error, error, stacktrace)
  end
end
