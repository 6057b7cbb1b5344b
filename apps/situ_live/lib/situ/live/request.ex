defmodule Situ.Live.Request do
  @moduledoc false
  # One HTTP request, as a route's handler receives it.
  #
  #   * `method` - `"GET"`, `"POST"` ...
  #   * `path` - as sent; `segments` - the path split at `/` and percent-decoded
  #   * `query` - the query decoded by `Situ.Live.Query`; `params` - values matched by the route's `:name` and `*rest`
  #   * `headers` - a map with lower-case names
  #   * `body` - the complete body; the server's `max_body` limits its size
  #   * `peer` - `{address, port}` of the client
  #   * `role` - `:viewer` if the client used the server's `viewer_token:`, else `:owner`
  alias Situ.Live.Query

  defstruct method: "GET",
            path: "/",
            segments: [],
            query_string: "",
            query: %{},
            params: %{},
            headers: %{},
            body: "",
            scheme: "http",
            host: "",
            peer: {{127, 0, 0, 1}, 0},
            role: :owner,
            endpoint: nil

  @type t :: %__MODULE__{
          method: String.t(),
          path: String.t(),
          segments: [String.t()],
          query_string: String.t(),
          query: map(),
          params: %{optional(String.t()) => String.t() | [String.t()]},
          headers: %{optional(String.t()) => String.t()},
          body: binary(),
          scheme: String.t(),
          host: String.t(),
          peer: {:inet.ip_address(), :inet.port_number()},
          role: :owner | :viewer,
          endpoint: term()
        }

  @doc "Builds a request from its parts; returns an error (status 400) if the path or query cannot be decoded."
  @spec new(String.t(), String.t(), %{optional(String.t()) => String.t()}, keyword()) ::
          {:ok, t()} | {:error, :bad_request}
  def new(method, target, headers, fields \\ []) do
    {path, query_string} =
      case :binary.split(target, "?") do
        [path, query] -> {path, query}
        [path] -> {path, ""}
      end

    with {:ok, segments} <- split_path(path),
         {:ok, query} <- Query.parse(query_string) do
      request = %__MODULE__{
        method: method,
        path: path,
        segments: segments,
        query_string: query_string,
        query: query,
        headers: headers,
        host: Map.get(headers, "host", "")
      }

      {:ok, struct!(request, fields)}
    else
      _ -> {:error, :bad_request}
    end
  end

  # NUL and similar characters never occur in valid names; browsers resolve `.` and `..` themselves.
  defp split_path("/" <> _ = path) do
    segments = path |> String.split("/", trim: true) |> Enum.map(&Query.percent_decode/1)

    if Enum.all?(segments, &valid_segment?/1), do: {:ok, segments}, else: :error
  end

  defp split_path(_), do: :error

  defp valid_segment?(:error), do: false

  defp valid_segment?(segment) do
    segment not in [".", ".."] and
      :binary.match(segment, ["/", "\\", <<0>>, "\n", "\r"]) == :nomatch
  end

  @doc """
  Returns the value of a header, or `nil`.

      iex> request = %Situ.Live.Request{method: "GET", path: "/a", headers: %{"accept" => "text/html"}}
      iex> Situ.Live.Request.get_header(request, "Accept")
      "text/html"
  """
  @spec get_header(t(), String.t()) :: String.t() | nil
  def get_header(%__MODULE__{headers: headers}, name), do: headers[String.downcase(name)]

  @doc ~S"""
  Returns the value of a cookie, or `nil`.

      iex> Situ.Live.Request.get_cookie(%Situ.Live.Request{headers: %{"cookie" => "a=1; b=2"}}, "b")
      "2"
  """
  @spec get_cookie(t(), String.t()) :: String.t() | nil
  def get_cookie(%__MODULE__{} = request, name) do
    request
    |> get_header("cookie")
    |> to_string()
    |> String.split(";")
    |> Enum.find_value(fn pair ->
      case pair |> String.trim() |> String.split("=", parts: 2) do
        [^name, value] -> value
        _ -> nil
      end
    end)
  end
end
