defmodule Situ.Broadway.ProducerGroup do
  @moduledoc false
  # Starts the processes of a Broadway producer as Broadway does: first the children that it asks for, then the
  # producers. One that dies ends the others, because the source of the pipeline decides about a restart.

  @doc "Starts the processes, linked to the caller. Returns the producers."
  @spec start_link({module(), term()}, keyword()) :: [pid()]
  def start_link({module, arg}, opts) do
    {children, broadway} = prepare(module, broadway_options({module, arg}, opts))
    {module, arg} = broadway[:producer][:module]

    producers =
      for index <- 0..(broadway[:producer][:concurrency] - 1) do
        arg =
          if Keyword.keyword?(arg), do: [broadway: [index: index] ++ broadway] ++ arg, else: arg

        %{id: {:producer, index}, start: {GenStage, :start_link, [module, arg]}}
      end

    case Supervisor.start_link(children ++ producers, strategy: :one_for_all, max_restarts: 0) do
      {:ok, supervisor} ->
        for {{:producer, _}, pid, _, _} <- Supervisor.which_children(supervisor), do: pid

      {:error, reason} ->
        raise start_error(module, reason)
    end
  end

  defp start_error(module, reason) do
    Situ.Error.new(:producer_failed, "the Broadway producer #{inspect(module)} did not start",
      why: Exception.format_exit(reason),
      fix: "check its options; some producers need broadway: [name: ...]"
    )
  end

  # Producers read the name and the sizes of the topology that they believe to be in.
  defp broadway_options({module, _arg} = producer, opts) do
    own = [
      name: Module.concat(Situ.Broadway, module),
      producer: [module: producer, concurrency: opts[:concurrency]],
      processors: [default: [concurrency: 1, max_demand: 1_000]],
      batchers: []
    ]

    Keyword.merge(own, opts[:broadway])
  end

  defp prepare(module, broadway) do
    if Code.ensure_loaded?(module) and function_exported?(module, :prepare_for_start, 2),
      do: module.prepare_for_start(Situ.Broadway, broadway),
      else: {[], broadway}
  end
end
