defmodule Situ.Error do
  @moduledoc """
  The error type that all apps use across their boundaries.

  `code` is for programs to match on. `what`, `why` and `fix` are sentences for people. `meta` holds further facts,
  such as component path, input, times or a stacktrace.

      iex> error = %Situ.Error{code: :no_store, what: "no store at \\"x\\"", fix: "check the path"}
      iex> Exception.message(error)
      "no store at \\"x\\"\\n  Fix: check the path"
  """

  @enforce_keys [:code, :what]
  defexception [:code, :what, :why, :fix, meta: %{}]

  @type t :: %__MODULE__{
          code: atom(),
          what: String.t(),
          why: String.t() | nil,
          fix: String.t() | nil,
          meta: map()
        }

  @doc """
  Builds an error; `details` may hold `:why`, `:fix` and `:meta`.

      iex> Situ.Error.new(:busy, "port 4040 is in use", fix: "choose another with --port").fix
      "choose another with --port"
  """
  @spec new(atom(), String.t(), keyword()) :: t()
  def new(code, what, details \\ []) when is_atom(code) and is_binary(what) do
    struct!(%__MODULE__{code: code, what: what}, details)
  end

  @doc """
  Returns the value of `{:ok, value}` or raises the error of `{:error, error}`. Functions that end in `!` use it.

      iex> Situ.Error.unwrap!({:ok, 1})
      1
      iex> Situ.Error.unwrap!({:error, Situ.Error.new(:busy, "port 4040 is in use")})
      ** (Situ.Error) port 4040 is in use
  """
  @spec unwrap!(:ok | {:ok, value} | {:error, Exception.t()}) :: :ok | value when value: term()
  def unwrap!(:ok), do: :ok
  def unwrap!({:ok, value}), do: value
  def unwrap!({:error, error}), do: raise(error)

  @doc """
  Formats the innermost place in a stack trace that has a source file, for `why:`.

      iex> stack = [{:maps, :get, [:x, %{}], []}, {Lobby, :build, 2, [file: 'lib/lobby.ex', line: 12]}]
      iex> Situ.Error.format_location(stack)
      "at lib/lobby.ex:12: Lobby.build/2"
      iex> Situ.Error.format_location([])
      nil
  """
  @spec format_location(Exception.stacktrace()) :: String.t() | nil
  def format_location(stack) do
    case Enum.find(stack, fn entry -> elem(entry, 3)[:file] != nil end) do
      nil -> nil
      entry -> "at " <> Exception.format_stacktrace_entry(entry)
    end
  end

  @doc """
  Maps items with `fun`, which returns `{:ok, value}`, and returns the values in order. Any other result of `fun`
  stops the iteration and is returned.

      iex> Situ.Error.map_ok(["1", "2"], fn text -> {:ok, String.to_integer(text)} end)
      {:ok, [1, 2]}
      iex> Situ.Error.map_ok([1, 0, :never_reached], fn n -> if n == 0, do: {:error, :zero}, else: {:ok, 1 / n} end)
      {:error, :zero}
  """
  @spec map_ok(Enumerable.t(), (term() -> {:ok, value} | other)) :: {:ok, [value]} | other
        when value: term(), other: term()
  def map_ok(items, fun) do
    result =
      Enum.reduce_while(items, {:ok, []}, fn item, {:ok, done} ->
        case fun.(item) do
          {:ok, value} -> {:cont, {:ok, [value | done]}}
          other -> {:halt, other}
        end
      end)

    with {:ok, done} <- result, do: {:ok, Enum.reverse(done)}
  end

  @impl true
  def message(%__MODULE__{} = error) do
    [error.what, error.why && "Why: " <> error.why, error.fix && "Fix: " <> error.fix]
    |> Enum.reject(&is_nil/1)
    |> Enum.join("\n  ")
  end
end
