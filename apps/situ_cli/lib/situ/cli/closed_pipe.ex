defmodule Situ.CLI.ClosedPipe do
  @moduledoc false
  # A reader that closes the pipe early (`situ store info x | head`) ends Erlang's output process. Its supervisor then
  # reports an error, which is useless to a user who wanted only the first lines.

  @doc "Keeps the error reports that follow a closed pipe out of the log."
  @spec silence_reports() :: :ok
  def silence_reports do
    _ = :logger.add_primary_filter(__MODULE__, {&filter_report/2, []})
    :ok
  end

  @doc """
  Returns `:stop` for reports of the output's supervisor, and `:ignore` for all other events.

      iex> state = {:state, :user_sup, :undefined, self(), {self(), :user_sup}}
      iex> report = %{label: {:gen_server, :terminate}, last_message: {:EXIT, self(), :epipe}, state: state}
      iex> Situ.CLI.ClosedPipe.filter_report(%{level: :error, msg: {:report, report}, meta: %{}}, [])
      :stop
      iex> Situ.CLI.ClosedPipe.filter_report(%{level: :error, msg: {:string, "other"}, meta: %{}}, [])
      :ignore
  """
  @spec filter_report(:logger.log_event(), term()) :: :stop | :ignore
  def filter_report(%{msg: {:report, %{last_message: {:EXIT, _, _}, state: state}}}, _extra)
      when is_tuple(state) and tuple_size(state) > 1 and elem(state, 1) == :user_sup,
      do: :stop

  def filter_report(_event, _extra), do: :ignore
end
