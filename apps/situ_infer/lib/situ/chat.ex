defmodule Situ.Chat do
  @own [
    system: [
      type: {:optional, :string},
      default: nil,
      doc: "Instructions for the model: the first turn of every conversation."
    ],
    remember: [
      type: :non_neg_integer,
      default: 8,
      doc:
        "How many previous questions and answers are sent to the model; used only if `concurrency` is 1."
    ],
    tools: [
      type: {:list, {:struct, Situ.Chat.Tool}},
      default: [],
      doc: "The tools the model may call, `Situ.Chat.Tool`."
    ],
    rounds: [
      type: :pos_integer,
      default: 5,
      doc: "How many requests one question may take, each of which may call tools."
    ],
    concurrency: [
      type: :pos_integer,
      default: 1,
      doc: "How many questions are asked concurrently; answers keep the order of the questions."
    ],
    budget: [
      type: {:optional, :pos_integer},
      default: nil,
      doc:
        "How many tokens may be read and written in total; after that, questions fail with `:budget_spent`."
    ],
    failures: [
      type: {:in, [:raise, :emit]},
      default: :raise,
      doc:
        "How a failed question is reported: as an error of the component (see `on_error`) or as a message on `:failed`."
    ]
  ]
  @schema @own ++ Situ.Chat.Service.schema()

  @moduledoc """
  Asks a language model, using any local or remote service that implements OpenAI's protocol.

      answers = Situ.via([in: questions], Situ.Chat, model: "llama3.2", system: "Answer in one sentence.")
      answers.text |> Situ.each(&IO.write/1)

  Input `:in` is a user's text (a string), a `Situ.Chat.Turn` (with images), or a whole conversation (a list of turns).
  A message on `:cancel` ends the questions in flight: their connections are closed, and the text received so far
  becomes the answer.

  | output | content | time |
  |---|---|---|
  | `:text` | the answer in chunks, as they arrive | the question's time, one nanosecond later for each |
  | `:calls` | the model's tool calls, `Situ.Chat.ToolCall` | likewise |
  | `:out` | the complete answer, `Situ.Chat.Answer` | the question's time |
  | `:failed` | a `Situ.Error`, with `failures: :emit` | the question's time |

  An answer has the time of its question, so it joins with other data of that time; the message's latency is the time
  the answer took. When `concurrency` questions are in flight, the component accepts no more, and its producer waits.

  Programs without pipelines can call `ask/2`.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component,
    inputs: [in: :any, cancel: {:any, optional: true}],
    outputs: [
      text: :string,
      calls: Situ.Chat.ToolCall,
      out: Situ.Chat.Answer,
      failed: Situ.Error
    ],
    options: @schema

  alias Situ.Chat.{Answer, Dialogue, Memory, Service, Turn}
  alias Situ.Error

  defstruct [
    :opts,
    :service,
    :memory,
    jobs: [],
    spent: 0,
    closing?: false,
    raising?: false,
    times: %{}
  ]

  @doc """
  Asks one question and waits for the answer. Accepts the options above, except options that concern streams.

      {:ok, answer} = Situ.Chat.ask("Who painted the Night Watch?", model: "llama3.2")
  """
  @spec ask(String.t() | Turn.t() | [Turn.t()], keyword()) ::
          {:ok, Answer.t()} | {:error, Error.t()}
  def ask(question, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, service} <- service(opts),
         {:ok, turns} <- Memory.turns(question) do
      {pid, ref} =
        Dialogue.start(
          self(),
          service,
          system(opts[:system]) ++ turns,
          opts[:tools],
          opts[:rounds]
        )

      monitor = Process.monitor(pid)
      answer(ref, monitor)
    end
  end

  defp answer(ref, monitor) do
    receive do
      {:situ_chat, ^ref, {:done, result}} ->
        Process.demonitor(monitor, [:flush])
        result

      {:situ_chat, ^ref, _event} ->
        answer(ref, monitor)

      {:DOWN, ^monitor, _, _, reason} ->
        {:error, Error.new(:chat_failed, "the request process ended: #{inspect(reason)}")}
    end
  end

  defp service(opts), do: Service.new(Keyword.take(opts, Keyword.keys(Service.schema())))
  defp system(nil), do: []
  defp system(text), do: [Turn.system(text)]

  @impl true
  def init(opts) do
    with {:ok, service} <- service(opts) do
      places = if opts[:concurrency] == 1, do: opts[:remember], else: 0
      {:ok, %__MODULE__{opts: Map.new(opts), service: service, memory: Memory.new(places)}}
    end
  end

  @impl true
  def describe(state), do: "#{length(state.jobs)} questions in flight, #{state.spent} tokens used"

  @impl true
  def handle_message(:in, %{data: question, originating_time: time}, _context, state) do
    turns = Error.unwrap!(Memory.turns(question))
    state |> add(turns, time) |> hold([])
  end

  def handle_message(:cancel, _message, _context, state) do
    jobs =
      for job <- state.jobs do
        if job.pid, do: Process.exit(job.pid, :kill)
        if job.done, do: job, else: %{job | pid: nil, done: {:ok, cancelled(job)}}
      end

    emit(%{state | jobs: jobs}, [])
  end

  defp cancelled(job),
    do: %Answer{
      text: IO.iodata_to_binary(job.said),
      finish: :cancelled,
      tokens: %{read: 0, written: job.count}
    }

  defp add(state, turns, time) do
    job = %{
      ref: make_ref(),
      pid: nil,
      time: time,
      turns: turns,
      said: [],
      count: 0,
      events: [],
      done: nil
    }

    start(%{state | jobs: state.jobs ++ [job]}, job)
  end

  defp start(%{opts: %{budget: budget}, spent: spent} = state, job)
       when is_integer(budget) and spent >= budget do
    error =
      Error.new(:budget_spent, "#{spent} of #{budget} tokens are used; no more requests are sent",
        fix: "raise budget:"
      )

    send(self(), {:situ_chat, job.ref, {:done, {:error, error}}})
    state
  end

  defp start(state, job) do
    turns = system(state.opts.system) ++ Memory.with(state.memory, job.turns)
    {pid, ref} = Dialogue.start(self(), state.service, turns, state.opts.tools, state.opts.rounds)
    put(state, %{job | pid: pid}, ref)
  end

  defp put(state, %{ref: old} = job, ref) do
    jobs = Enum.map(state.jobs, &if(&1.ref == old, do: %{job | ref: ref}, else: &1))
    %{state | jobs: jobs}
  end

  @impl true
  def handle_info({:situ_chat, ref, event}, _context, state),
    do: state |> note(ref, event) |> emit([])

  # The error is raised in a separate message, so that its handling does not discard other results.
  def handle_info({:situ_chat_failed, error}, _context, _state), do: raise(error)
  def handle_info(:situ_chat_raised, _context, state), do: emit(%{state | raising?: false}, [])
  def handle_info({:hold_ended, :in}, _context, state), do: hold(state, [])

  # The input is closed, so the component waits for the questions in flight, one event at a time.
  def handle_info({:continue, :wait}, _context, %{jobs: []} = state), do: {[], state}

  def handle_info({:continue, :wait}, _context, %{raising?: true} = state),
    do: {[{:continue, :wait}], state}

  def handle_info({:continue, :wait}, _context, state) do
    receive do
      {:situ_chat, ref, event} -> state |> note(ref, event) |> emit([])
    after
      # Returns regularly so that the pipeline's own messages are handled.
      20 -> {[{:continue, :wait}], state}
    end
  end

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def handle_closed(:in, _time, _context, state), do: emit(%{state | closing?: true}, [])
  def handle_closed(:cancel, _time, _context, state), do: {[], state}

  @impl true
  def terminate(_reason, state) do
    for %{pid: pid} when is_pid(pid) <- state.jobs, do: Process.exit(pid, :kill)
    :ok
  end

  defp note(state, ref, event) do
    jobs =
      for job <- state.jobs,
          do: if(job.ref == ref and job.done == nil, do: noted(job, event), else: job)

    %{state | jobs: jobs}
  end

  defp noted(job, {:done, result}), do: %{job | done: result, pid: nil}

  defp noted(job, {:text, text} = e),
    do: %{job | said: [job.said, text], count: job.count + 1, events: [e | job.events]}

  defp noted(job, {:call, _} = event), do: %{job | events: [event | job.events]}

  # Only the oldest question emits; events of the others are kept until it has ended.
  defp emit(%{raising?: true} = state, actions), do: hold(state, actions)
  defp emit(%{jobs: []} = state, actions), do: hold(state, actions)

  defp emit(%{jobs: [job | rest]} = state, actions) do
    {actions, state} = speak(Enum.reverse(job.events), job.time, actions, state)

    case job.done do
      nil -> hold(%{state | jobs: [%{job | events: []} | rest]}, actions)
      {:ok, answer} -> answered(%{state | jobs: rest}, job, answer, actions)
      {:error, error} -> failed(%{state | jobs: rest}, job, error, actions)
    end
  end

  defp speak(events, time, actions, state) do
    Enum.reduce(events, {actions, state}, fn {kind, data}, {actions, state} ->
      output = if kind == :call, do: :calls, else: :text
      at = max(time, Map.get(state.times, output, time - 1) + 1)
      {[{output, at, data} | actions], %{state | times: Map.put(state.times, output, at)}}
    end)
  end

  defp answered(state, job, answer, actions) do
    spent = state.spent + answer.tokens.read + answer.tokens.written
    memory = Memory.add(state.memory, job.turns, answer)
    emit(%{state | spent: spent, memory: memory}, [{:out, job.time, answer} | actions])
  end

  defp failed(%{opts: %{failures: :emit}} = state, job, error, actions),
    do: emit(state, [{:failed, job.time, error} | actions])

  defp failed(state, job, error, actions) do
    meta = Map.put(error.meta, :originating_time, job.time)
    send(self(), {:situ_chat_failed, %{error | meta: meta}})
    send(self(), :situ_chat_raised)
    hold(%{state | raising?: true}, actions)
  end

  # At the limit, the input is held so that its producer waits.
  defp hold(%{closing?: true, jobs: jobs, raising?: raising?} = state, actions) do
    waiting = if jobs != [] or raising?, do: [{:continue, :wait}], else: []
    {Enum.reverse(actions) ++ waiting, state}
  end

  defp hold(%{jobs: jobs, opts: %{concurrency: most}} = state, actions) do
    action = if length(jobs) >= most, do: {:hold, :in}, else: {:resume, :in}
    {Enum.reverse([action | actions]), state}
  end
end
