defmodule Situ.Component.Callback do
  @moduledoc false
  # A component and the calls to its callbacks. Every result or exception becomes a value. This module does not depend
  # on processes, except that it notes the component for log lines (`Situ.Component.LogContext`).
  alias Situ.{Columns, Component, Error, Message}
  alias Situ.Component.FunctionSwap
  alias Situ.Delivery.Batch

  @enforce_keys [:module, :path, :opts, :on_error]
  defstruct [:module, :path, :opts, :on_error, :core, batch: false, columns: :none]

  @typedoc """
  `core` is the component's state. With `batch` it handles several messages in one call. `columns` says which
  messages it receives as `Situ.Columns`: `:none`, `:emitted` (only columns that a component has emitted), or `:all`
  numbers, because it does not take lists of messages.
  """
  @type t :: %__MODULE__{
          module: module(),
          path: String.t(),
          opts: keyword(),
          on_error: :stop | :skip | :restart,
          core: Component.state(),
          batch: boolean(),
          columns: :none | :emitted | :all
        }
  @type outcome :: {:ok, [Component.action()], Component.state()} | {:error, Error.t()}

  @doc "Builds the component of a vertex, before its `init/1`."
  @spec new(Situ.Graph.Vertex.t()) :: t()
  def new(vertex) do
    note_batches(%__MODULE__{
      module: vertex.module,
      path: vertex.path,
      opts: vertex.opts,
      on_error: vertex.on_error
    })
  end

  defp note_batches(%{module: module} = callback) do
    columns? = function_exported?(module, :handle_columns, 4)
    messages? = function_exported?(module, :handle_messages, 4)

    columns =
      cond do
        not columns? -> :none
        messages? -> :emitted
        true -> :all
      end

    %{callback | batch: columns? or messages?, columns: columns}
  end

  @doc "Initializes the component's state."
  @spec start_component(t()) :: {:ok, t()} | {:error, Error.t()}
  def start_component(%__MODULE__{} = callback) do
    with {:ok, core} <- run_init(callback.module, callback.opts, callback.path),
         do: {:ok, %{callback | core: core}}
  end

  @doc "Releases the component's resources."
  @spec stop_component(t(), term()) :: :ok | {:error, Error.t()}
  def stop_component(%__MODULE__{} = callback, reason),
    do: run_terminate(callback.module, reason, callback.core, callback.path)

  @doc "Calls any callback that returns `{actions, state}`; the state is its last argument."
  @spec call_callback(t(), atom(), [term()]) :: outcome()
  def call_callback(%__MODULE__{} = callback, name, args),
    do: run_callback(callback.module, name, args ++ [callback.core], callback.path)

  @doc "Returns the component's one-line description, or `nil` if it does not define `describe/1`."
  @spec describe_state(t()) :: String.t() | nil
  def describe_state(%__MODULE__{module: module, core: core}) do
    if function_exported?(module, :describe, 1), do: module.describe(core)
  rescue
    error -> "describe failed: " <> Exception.message(error)
  end

  @doc """
  Replaces the component's module or options. With `migrate/3` the state is migrated; otherwise the new component is
  started. Also returns the actions of its start.
  """
  @spec replace_component(t(), module(), keyword(), Component.Context.t()) ::
          {:ok, t(), [Component.action()]} | {:error, Error.t()}
  def replace_component(%__MODULE__{} = old, module, opts, context) do
    new = note_batches(%{old | module: module, opts: opts})

    if function_exported?(module, :migrate, 3),
      do: migrate_state(old, new),
      else: start_replacement(old, new, context)
  end

  @doc """
  Replaces the functions in the component's options, and the same functions in its state. A component with `migrate/3`
  does this itself.
  """
  @spec replace_functions(t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def replace_functions(%__MODULE__{} = old, opts) do
    if function_exported?(old.module, :migrate, 3) do
      with {:ok, new, []} <- migrate_state(old, %{old | opts: opts}), do: {:ok, new}
    else
      {:ok,
       %{
         old
         | opts: opts,
           core:
             FunctionSwap.replace_functions(old.core, FunctionSwap.pair_functions(old.opts, opts))
       }}
    end
  end

  defp migrate_state(old, new) do
    case new.module.migrate(old.core, old.opts, new.opts) do
      {:ok, core} ->
        {:ok, %{new | core: core}, []}

      {:error, %Error{} = error} ->
        {:error, add_component_path(error, old.path)}

      other ->
        {:error, bad_return_error(old.path, "migrate", "{:ok, state} or {:error, error}", other)}
    end
  catch
    kind, reason -> {:error, exception_error(old.path, "migrate", kind, reason, __STACKTRACE__)}
  end

  defp start_replacement(old, new, context) do
    with {:ok, new} <- start_component(new),
         {:ok, actions, core} <- call_callback(new, :handle_start, [context]) do
      stop_component(old, :replaced)
      {:ok, %{new | core: core}, actions}
    end
  end

  @doc "Calls `init/1`, which returns `{:ok, state}` or `{:error, error}`."
  @spec run_init(module(), keyword(), String.t()) :: {:ok, term()} | {:error, Error.t()}
  def run_init(module, opts, path) do
    Process.put(:situ_handling, {path, nil})

    case module.init(opts) do
      {:ok, state} -> {:ok, state}
      {:error, %Error{} = error} -> {:error, add_component_path(error, path)}
      other -> {:error, bad_return_error(path, "init", "{:ok, state} or {:error, error}", other)}
    end
  catch
    kind, reason -> {:error, exception_error(path, "init", kind, reason, __STACKTRACE__)}
  end

  @doc "Calls any callback that returns `{actions, state}`."
  @spec run_callback(module(), atom(), [term()], String.t()) :: outcome()
  def run_callback(module, callback, args, path) do
    Process.put(:situ_handling, {path, nil})
    module |> apply(callback, args) |> check_result(callback, path)
  catch
    kind, reason -> {:error, exception_error(path, callback, kind, reason, __STACKTRACE__)}
  end

  @doc "Calls `handle_message/4`, the most frequent callback."
  @spec run_handle_message(t(), atom(), Message.t(), Component.Context.t()) :: outcome()
  def run_handle_message(
        %__MODULE__{module: module, path: path, core: core},
        input,
        message,
        context
      ) do
    Process.put(:situ_handling, {path, message.originating_time})

    case module.handle_message(input, message, context, core) do
      {actions, core} when is_list(actions) -> {:ok, actions, core}
      other -> {:error, bad_result(path, input, message, other)}
    end
  catch
    kind, reason ->
      error = exception_error(path, input, kind, reason, __STACKTRACE__)
      {:error, add_message_info(error, input, message)}
  end

  @doc """
  Calls `handle_columns/4` or `handle_messages/4`; returns `:failed` on any failure, because the messages are then
  handled one by one.
  """
  @spec run_handle_batch(t(), atom(), Batch.t(), Component.Context.t()) ::
          {:ok, [Component.action()], Component.state()} | :failed
  def run_handle_batch(%__MODULE__{module: module, core: core} = callback, input, batch, context) do
    Process.put(:situ_handling, {callback.path, batch})

    result =
      case select_form(callback.columns, batch) do
        {:columns, columns} -> module.handle_columns(input, columns, context, core)
        :messages -> module.handle_messages(input, Batch.messages(batch), context, core)
        :single -> :failed
      end

    case result do
      {actions, core} when is_list(actions) -> {:ok, actions, core}
      _ -> :failed
    end
  catch
    _kind, _reason -> :failed
  after
    # A component that waits must not keep the data of its last batch.
    Process.put(:situ_handling, {callback.path, nil})
  end

  defp select_form(:all, batch) do
    case Batch.columns(batch) do
      {:ok, columns} -> {:columns, columns}
      :error -> :single
    end
  end

  defp select_form(:emitted, %Columns{} = columns), do: {:columns, columns}
  defp select_form(_form, _batch), do: :messages

  @doc "Calls a callback that returns `{:ok, reply, opts, actions, state}` or `{:error, error}`."
  @spec call_with_reply(t(), atom(), [term()]) ::
          {:ok, term(), keyword(), [Component.action()], Component.state()} | {:error, Error.t()}
  def call_with_reply(%__MODULE__{module: module, path: path, core: core}, callback, args) do
    Process.put(:situ_handling, {path, nil})

    case apply(module, callback, args ++ [core]) do
      {:ok, _reply, opts, actions, _state} = answer when is_list(opts) and is_list(actions) ->
        answer

      {:error, %Error{} = error} ->
        {:error, add_component_path(error, path)}

      other ->
        expected = "{:ok, reply, opts, actions, state} or {:error, error}"
        {:error, bad_return_error(path, callback, expected, other)}
    end
  catch
    kind, reason -> {:error, exception_error(path, callback, kind, reason, __STACKTRACE__)}
  end

  @doc "Calls `terminate/2`. An exception in it becomes an error like any other, but stops nothing."
  @spec run_terminate(module(), term(), term(), String.t()) :: :ok | {:error, Error.t()}
  def run_terminate(module, reason, state, path) do
    Process.put(:situ_handling, {path, nil})
    module.terminate(reason, state)
    :ok
  catch
    kind, reason -> {:error, exception_error(path, "terminate", kind, reason, __STACKTRACE__)}
  end

  @doc "Converts an exception to an error that names the component and the callback or input."
  @spec exception_error(String.t(), term(), atom(), term(), list()) :: Error.t()
  def exception_error(path, _where, :error, %Error{} = error, stack),
    do: add_component_path(%{error | meta: Map.put_new(error.meta, :stacktrace, stack)}, path)

  def exception_error(path, where, kind, reason, stack) do
    exception = if kind == :error, do: Exception.normalize(:error, reason, stack)
    banner = Exception.format_banner(kind, reason, stack)

    Error.new(:component_failed, "#{path} failed (#{where}): #{banner}",
      why: Error.format_location(stack),
      meta: %{
        component: path,
        kind: kind,
        exception: exception,
        reason: reason,
        stacktrace: stack
      }
    )
  end

  @doc "Adds the input and the message's originating time to an error."
  @spec add_message_info(Error.t(), atom(), Message.t()) :: Error.t()
  def add_message_info(%Error{} = error, input, message) do
    meta = Map.merge(error.meta, %{input: input, originating_time: message.originating_time})
    %{error | meta: meta}
  end

  @doc "Adds the component's path to an error that lacks one."
  @spec add_component_path(Error.t(), String.t()) :: Error.t()
  def add_component_path(%Error{} = error, path),
    do: %{error | meta: Map.put_new(error.meta, :component, path)}

  @doc "Returns the error for an invalid action."
  @spec bad_action_error(String.t(), term()) :: Error.t()
  def bad_action_error(path, action) do
    Error.new(
      :bad_action,
      "#{path} returned #{inspect(action, limit: 8)}, which is not an action",
      fix:
        "return actions from Situ.Component: {output, originating_time, data}, {:timer, key, time}, ...",
      meta: %{component: path}
    )
  end

  defp check_result({actions, state}, _callback, _path) when is_list(actions),
    do: {:ok, actions, state}

  defp check_result(other, callback, path),
    do: {:error, bad_return_error(path, callback, "{actions, state}", other)}

  defp bad_result(path, input, message, other) do
    path
    |> bad_return_error("handle_message", "{actions, state}", other)
    |> add_message_info(input, message)
  end

  defp bad_return_error(path, callback, expected, other) do
    Error.new(:bad_return, "#{path}: #{callback} returned #{inspect(other, limit: 8)}",
      why: "it must return #{expected}",
      meta: %{component: path}
    )
  end
end
