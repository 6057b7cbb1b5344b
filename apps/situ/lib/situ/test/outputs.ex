defmodule Situ.Test.Outputs do
  @moduledoc false
  # The outputs of a pipeline under test that the test has not checked yet. They arrive in the mailbox of the test's
  # process. An assertion takes some of them, so the others wait in its process dictionary.
  alias Situ.Test

  @doc "Returns the keys of the outputs, in the order of the shape that the test's function returned."
  @spec list_keys(Test.t()) :: [term()]
  def list_keys(%Test{shape: :only}), do: [:only]
  def list_keys(%Test{shape: {_kind, keys}}), do: keys

  @doc "Returns the key that the option `output:` means. Raises if a pipeline has several outputs, and none is named."
  @spec resolve_key!(Test.t(), keyword()) :: term()
  def resolve_key!(%Test{} = test, opts) do
    keys = list_keys(test)
    opts = Situ.Options.validate!(opts, output: [type: :any])

    case {Keyword.fetch(opts, :output), keys} do
      {:error, [key]} ->
        key

      {{:ok, key}, _keys} ->
        if key in keys, do: key, else: raise_unknown!("no output #{inspect(key)}", keys)

      {:error, _keys} ->
        raise_unknown!("the pipeline has several outputs: name one with output:", keys)
    end
  end

  defp raise_unknown!(problem, keys),
    do:
      raise(
        ArgumentError,
        "#{problem}; the outputs are: #{Enum.map_join(keys, ", ", &inspect/1)}"
      )

  @doc "Returns the waiting messages of an output."
  @spec list_waiting(Test.t(), term()) :: [Test.timed()]
  def list_waiting(%Test{ref: ref}, key), do: ref |> receive_all() |> Map.get(key, [])

  @doc "Replaces the waiting messages of an output."
  @spec put_waiting(Test.t(), term(), [Test.timed()]) :: :ok
  def put_waiting(%Test{ref: ref}, key, messages) do
    Process.put({__MODULE__, ref}, ref |> receive_all() |> Map.put(key, messages))
    :ok
  end

  @doc "Takes the waiting messages of all outputs."
  @spec take_all(Test.t()) :: %{term() => [Test.timed()]}
  def take_all(%Test{ref: ref}) do
    waiting = receive_all(ref)
    Process.delete({__MODULE__, ref})
    waiting
  end

  defp receive_all(ref) do
    waiting = receive_rest(ref, Process.get({__MODULE__, ref}, %{}))
    Process.put({__MODULE__, ref}, waiting)
    waiting
  end

  defp receive_rest(ref, waiting) do
    receive do
      {:situ_collected, {^ref, key}, messages} ->
        messages = for m <- messages, do: {m.originating_time, m.data}
        receive_rest(ref, Map.update(waiting, key, messages, &(&1 ++ messages)))
    after
      0 -> waiting
    end
  end
end
