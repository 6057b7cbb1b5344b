defmodule Situ.Chat.ToolLoop do
  @moduledoc false
  # Asks one question, runs the requested tools, and asks again with their results until the model has answered. Runs in
  # its own process, which the caller may kill.
  alias Situ.Chat.{Answer, Model, Tool, Turn}
  alias Situ.Error

  @type event :: {:text, String.t()} | {:call, Situ.Chat.ToolCall.t()}

  @doc "Returns the answer, with the text and the token counts of all rounds."
  @spec run(Model.t(), [Turn.t()], [Tool.t()], pos_integer(), (event() -> any())) ::
          {:ok, Answer.t()} | {:error, Error.t()}
  def run(model, turns, tools, rounds, emit_event),
    do: run_rounds(model, turns, tools, rounds, emit_event, %{text: "", read: 0, written: 0})

  defp run_rounds(_model, _turns, _tools, 0, _emit_event, _totals) do
    {:error,
     Error.new(:too_many_calls, "the model kept calling tools and gave no final answer",
       fix: "raise rounds:, or explain in system: when to use the tools"
     )}
  end

  defp run_rounds(model, turns, tools, rounds, emit_event, totals) do
    with {:ok, answer} <- Model.ask(model, turns, tools, &emit_event.({:text, &1})) do
      totals = %{
        text: totals.text <> answer.text,
        read: totals.read + answer.tokens.read,
        written: totals.written + answer.tokens.written
      }

      Enum.each(answer.calls, &emit_event.({:call, &1}))

      if answer.calls != [] and Enum.all?(answer.calls, &runnable?(tools, &1)) do
        results = for call <- answer.calls, do: Turn.tool(call.id, Tool.run_call(tools, call))
        turns = turns ++ [Turn.assistant(answer.text, answer.calls) | results]
        run_rounds(model, turns, tools, rounds - 1, emit_event, totals)
      else
        tokens = Map.take(totals, [:read, :written])
        {:ok, %{answer | text: totals.text, tokens: tokens}}
      end
    end
  end

  # Calls of unknown tools also get a result, so that the model learns about the mistake.
  defp runnable?(tools, call) do
    case Enum.find(tools, &(&1.name == call.name)) do
      %{run: nil} -> false
      _ -> true
    end
  end

  @doc """
  Starts `run/5` in a separate process, which ends with `owner`. `owner` receives `{:situ_chat, ref, event}` messages,
  and finally `{:situ_chat, ref, {:done, result}}`.
  """
  @spec start(pid(), Model.t(), [Turn.t()], [Tool.t()], pos_integer()) :: {pid(), reference()}
  def start(owner, model, turns, tools, rounds) do
    ref = make_ref()

    pid =
      spawn(fn ->
        kill_with_owner(owner, self())
        emit_event = &send(owner, {:situ_chat, ref, &1})
        emit_event.({:done, run_guarded(fn -> run(model, turns, tools, rounds, emit_event) end)})
      end)

    {pid, ref}
  end

  defp kill_with_owner(owner, worker) do
    spawn(fn ->
      [a, b] = for pid <- [owner, worker], do: Process.monitor(pid)

      receive do
        {:DOWN, ^a, _, _, _} -> Process.exit(worker, :kill)
        {:DOWN, ^b, _, _, _} -> :ok
      end
    end)
  end

  # Crashes are caught because a crash report would show the arguments, including the key.
  defp run_guarded(fun) do
    fun.()
  catch
    kind, reason ->
      name = if kind == :error, do: Exception.normalize(:error, reason).__struct__, else: kind

      {:error,
       Error.new(:chat_failed, "asking the language model failed: #{inspect(name)}",
         why: "a bug in Situ, or in a function passed to it"
       )}
  end
end
