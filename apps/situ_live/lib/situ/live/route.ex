defmodule Situ.Live.Route do
  @moduledoc false
  # The routes of a server, as plain data that is matched in order.
  #
  # | route | serves |
  # |---|---|
  # | `{:live, path, View}`, `{:live, path, View, opts}` | a page: a view (`Situ.Live.View`) in the layout |
  # | `{:get, path, handler}` or `:post`, `:put`, `:patch`, `:delete`, `:any` (or with `opts`) | the handler's response |
  # | `{:static, path, dir}`, `{:static, path, {app, dir}}`, `{:static, path, dir, opts}` | files in `dir` (GET, HEAD) |
  # | `{:socket, path, Module, arg}`, `{:socket, path, Module, arg, opts}` | a WebSocket (`Situ.Live.SocketHandler`) |
  #
  # A path is matched segment by segment: `:name` matches one segment, `*rest` all remaining ones.
  # Both are in the request's `params` (a view's `params`). A handler is a function of one
  # argument (the `Situ.Live.Request`), or `{Module, arg}`, for which the server calls
  # `Module.call(request, arg)`. It returns a `Situ.Live.Response`.
  #
  # Options of `:live`: `action:` (the socket's `live_action`), `session:` (a JSON-able map, or a
  # function that computes it from the request; signed into the page and passed to `mount/3`),
  # `layout:` (replaces the server's layout). Options of the handlers: `max_body:` (bytes).
  # Options of `:static`: `cache:` (the `cache-control` header). Options of `:socket`:
  # `max_frame:` (bytes of an incoming message, default 65,536).
  alias Situ.Live.Request

  @methods [:get, :post, :put, :patch, :delete, :any]

  @enforce_keys [:kind, :pattern, :target]
  defstruct [:kind, :pattern, :target, methods: :any, arg: nil, opts: []]

  @type t :: %__MODULE__{
          kind: :live | :http | :static | :socket,
          pattern: [String.t() | {:one | :rest, String.t()}],
          target: term(),
          methods: :any | [String.t()],
          arg: term(),
          opts: keyword()
        }

  @doc """
  Validates and compiles routes; raises `ArgumentError` for an invalid route.

      iex> routes = Situ.Live.Route.compile([{:get, "/rooms/:id/*rest", &Function.identity/1}])
      iex> request = %Situ.Live.Request{segments: ["rooms", "7", "a", "b"]}
      iex> {:ok, _route, params} = Situ.Live.Route.match_request(routes, request)
      iex> params
      %{"id" => "7", "rest" => ["a", "b"]}
  """
  @spec compile([tuple()]) :: [t()]
  def compile(routes), do: Enum.map(routes, &compile_route/1)

  defp compile_route({:live, path, view}), do: compile_route({:live, path, view, []})

  defp compile_route({:live, path, view, opts}) when is_atom(view) and is_list(opts) do
    Code.ensure_loaded(view)

    unless function_exported?(view, :render, 1),
      do:
        raise(ArgumentError, "#{inspect(view)} is not a view because it does not define render/1")

    %__MODULE__{
      kind: :live,
      pattern: parse_pattern(path),
      target: view,
      methods: ["GET"],
      opts: opts
    }
  end

  defp compile_route({method, path, handler}) when method in @methods,
    do: compile_route({method, path, handler, []})

  defp compile_route({method, path, handler, opts}) when method in @methods do
    unless is_function(handler, 1) or match?({module, _} when is_atom(module), handler),
      do:
        raise(ArgumentError, "a handler must be fun/1 or {module, arg}, got: #{inspect(handler)}")

    methods = if method == :any, do: :any, else: [method |> to_string() |> String.upcase()]

    %__MODULE__{
      kind: :http,
      pattern: parse_pattern(path),
      target: handler,
      methods: methods,
      opts: opts
    }
  end

  defp compile_route({:static, path, dir}), do: compile_route({:static, path, dir, []})

  defp compile_route({:static, path, dir, opts}) do
    pattern = parse_pattern(path) ++ [{:rest, "path"}]
    %__MODULE__{kind: :static, pattern: pattern, target: dir, methods: ["GET"], opts: opts}
  end

  defp compile_route({:socket, path, module, arg}),
    do: compile_route({:socket, path, module, arg, []})

  defp compile_route({:socket, path, module, arg, opts}) when is_atom(module) do
    %__MODULE__{
      kind: :socket,
      pattern: parse_pattern(path),
      target: module,
      arg: arg,
      methods: ["GET"],
      opts: opts
    }
  end

  defp compile_route(other), do: raise(ArgumentError, "invalid route: #{inspect(other)}")

  defp parse_pattern("/" <> _ = path) do
    path
    |> String.split("/", trim: true)
    |> Enum.map(fn
      ":" <> name -> {:one, name}
      "*" <> name -> {:rest, name}
      segment -> segment
    end)
  end

  defp parse_pattern(path),
    do: raise(ArgumentError, "a path must start with /, got: #{inspect(path)}")

  @doc "Returns the first matching route and the parameters from its pattern."
  @spec match_request([t()], Request.t()) ::
          {:ok, t(), map()} | {:error, :not_found | {:method, [String.t()]}}
  def match_request(routes, %Request{segments: segments, method: method}) do
    method = if method == "HEAD", do: "GET", else: method

    Enum.reduce_while(routes, {:error, :not_found}, fn route, acc ->
      case {match_pattern(route.pattern, segments, %{}), acc} do
        {:no, _} -> {:cont, acc}
        {params, _} when route.methods == :any -> {:halt, {:ok, route, params}}
        {params, {:error, other}} -> check_method(method in route.methods, route, params, other)
      end
    end)
  end

  defp check_method(true, route, params, _), do: {:halt, {:ok, route, params}}

  defp check_method(false, r, _, {:method, methods}),
    do: {:cont, {:error, {:method, methods ++ r.methods}}}

  defp check_method(false, route, _, :not_found), do: {:cont, {:error, {:method, route.methods}}}

  defp match_pattern([], [], params), do: params
  defp match_pattern([{:rest, name}], rest, params), do: Map.put(params, name, rest)

  defp match_pattern([{:one, n} | ps], [s | ss], params),
    do: match_pattern(ps, ss, Map.put(params, n, s))

  defp match_pattern([segment | ps], [segment | ss], params), do: match_pattern(ps, ss, params)
  defp match_pattern(_, _, _), do: :no
end
