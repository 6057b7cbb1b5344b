defmodule Situ.Stage.Call do
  @moduledoc false
  # Calls into a component: whatever comes back or goes wrong becomes a value. Nothing here knows of processes.
  alias Situ.{Component, Error, Message}

  @type outcome :: {:ok, [Component.action()], Component.state()} | {:error, Error.t()}

  @doc "`init/1`, which answers `{:ok, state}` or `{:error, error}`."
  @spec init(module(), keyword(), String.t()) :: {:ok, term()} | {:error, Error.t()}
  def init(module, opts, path) do
    case module.init(opts) do
      {:ok, state} -> {:ok, state}
      {:error, %Error{} = error} -> {:error, located(error, path)}
      other -> {:error, rubbish(path, "init", "{:ok, state} or {:error, error}", other)}
    end
  catch
    kind, reason -> {:error, failure(path, "init", kind, reason, __STACKTRACE__)}
  end

  @doc "Any callback that answers `{actions, state}`."
  @spec run(module(), atom(), [term()], String.t()) :: outcome()
  def run(module, callback, args, path) do
    module |> apply(callback, args) |> checked(callback, path)
  catch
    kind, reason -> {:error, failure(path, callback, kind, reason, __STACKTRACE__)}
  end

  @doc "`handle_message/4`, the callback that is called most."
  @spec message(module(), atom(), Message.t(), Component.Context.t(), term(), String.t()) ::
          outcome()
  def message(module, input, message, context, state, path) do
    case module.handle_message(input, message, context, state) do
      {actions, state} when is_list(actions) -> {:ok, actions, state}
      other -> {:error, bad_result(path, input, message, other)}
    end
  catch
    kind, reason ->
      error = failure(path, input, kind, reason, __STACKTRACE__)
      {:error, at(error, input, message)}
  end

  @doc "`handle_messages/4`; `:failed` for whatever goes wrong, since the messages are then taken one by one."
  @spec messages(module(), atom(), [Message.t()], Component.Context.t(), term()) ::
          {:ok, [Component.action()], Component.state()} | :failed
  def messages(module, input, messages, context, state) do
    case module.handle_messages(input, messages, context, state) do
      {actions, state} when is_list(actions) -> {:ok, actions, state}
      _ -> :failed
    end
  catch
    _kind, _reason -> :failed
  end

  @doc "A callback that answers `{:ok, reply, opts, actions, state}` or `{:error, error}`."
  @spec ask(module(), atom(), [term()], String.t()) ::
          {:ok, term(), keyword(), [Component.action()], Component.state()} | {:error, Error.t()}
  def ask(module, callback, args, path) do
    case apply(module, callback, args) do
      {:ok, _reply, opts, actions, _state} = answer when is_list(opts) and is_list(actions) ->
        answer

      {:error, %Error{} = error} ->
        {:error, located(error, path)}

      other ->
        wanted = "{:ok, reply, opts, actions, state} or {:error, error}"
        {:error, rubbish(path, callback, wanted, other)}
    end
  catch
    kind, reason -> {:error, failure(path, callback, kind, reason, __STACKTRACE__)}
  end

  @doc "Release: a raising `terminate/2` is an error like any other, but stops nothing."
  @spec terminate(module(), term(), term(), String.t()) :: :ok | {:error, Error.t()}
  def terminate(module, reason, state, path) do
    module.terminate(reason, state)
    :ok
  catch
    kind, reason -> {:error, failure(path, "terminate", kind, reason, __STACKTRACE__)}
  end

  @doc "An exception as an error that names the component and where it was."
  @spec failure(String.t(), term(), atom(), term(), list()) :: Error.t()
  def failure(path, _where, :error, %Error{} = error, stack),
    do: located(%{error | meta: Map.put_new(error.meta, :stacktrace, stack)}, path)

  def failure(path, where, kind, reason, stack) do
    exception = if kind == :error, do: Exception.normalize(:error, reason, stack)
    banner = Exception.format_banner(kind, reason, stack)

    Error.new(:component_failed, "#{path} failed (#{where}): #{banner}",
      why: where_from(stack),
      meta: %{
        component: path,
        kind: kind,
        exception: exception,
        reason: reason,
        stacktrace: stack
      }
    )
  end

  @doc "Adds the input and the message's time."
  @spec at(Error.t(), atom(), Message.t()) :: Error.t()
  def at(%Error{} = error, input, message) do
    meta = Map.merge(error.meta, %{input: input, originating_time: message.originating_time})
    %{error | meta: meta}
  end

  @doc "Adds the component's path to an error that lacks one."
  @spec located(Error.t(), String.t()) :: Error.t()
  def located(%Error{} = error, path),
    do: %{error | meta: Map.put_new(error.meta, :component, path)}

  @doc "The error of an action that is none."
  @spec bad_action(String.t(), term()) :: Error.t()
  def bad_action(path, action) do
    Error.new(:bad_action, "#{path} returned #{inspect(action, limit: 8)}, which is no action",
      fix: "see Situ.Component: {output, originating_time, data}, {:timer, key, time}, ...",
      meta: %{component: path}
    )
  end

  defp checked({actions, state}, _callback, _path) when is_list(actions),
    do: {:ok, actions, state}

  defp checked(other, callback, path),
    do: {:error, rubbish(path, callback, "{actions, state}", other)}

  defp bad_result(path, input, message, other) do
    path |> rubbish("handle_message", "{actions, state}", other) |> at(input, message)
  end

  defp rubbish(path, callback, wanted, other) do
    Error.new(:bad_return, "#{path}: #{callback} returned #{inspect(other, limit: 8)}",
      why: "it must return #{wanted}",
      meta: %{component: path}
    )
  end

  defp where_from(stack) do
    case Enum.find(stack, fn entry -> elem(entry, 3)[:file] != nil end) do
      nil -> nil
      entry -> "at " <> Exception.format_stacktrace_entry(entry)
    end
  end
end
