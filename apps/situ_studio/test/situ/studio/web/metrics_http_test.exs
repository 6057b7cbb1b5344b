defmodule Situ.Studio.Web.MetricsHttpTest do
  use ExUnit.Case, async: true
  alias Situ.Live.Request
  alias Situ.Studio.Web.MetricsHttp

  test "serves metrics as text, which Prometheus reads by its type" do
    response = MetricsHttp.call(%Request{method: "GET", path: "/metrics"}, :metrics)
    assert {"content-type", "text/plain; version=0.0.4; charset=utf-8"} in response.headers
    assert response.body =~ "# TYPE situ_vm_processes gauge"
  end

  test "reports a pipeline that should run and does not" do
    request = &%Request{method: "GET", path: "/health", query: &1}
    assert MetricsHttp.call(request.(%{}), :health).status == 200
    response = MetricsHttp.call(request.(%{"pipeline" => "No such pipeline"}), :health)
    assert {response.status, response.body =~ "is not running"} == {503, true}
    # A query can contain anything.
    assert MetricsHttp.call(request.(%{"pipeline" => %{"a" => "b"}}), :health).status == 200
  end

  @tag :tmp_dir
  test "a studio with a token serves them only with it", %{tmp_dir: folder} do
    {:ok, studio} =
      Situ.Studio.start_link(path: folder, port: 0, token: "owners-secret-of-32-characters-or-so")

    port = Situ.Studio.port(studio)
    assert get(port, "/metrics", "") =~ "HTTP/1.1 40"
    login = "authorization: Bearer owners-secret-of-32-characters-or-so\r\n"
    assert get(port, "/metrics", login) =~ "situ_vm_processes"
    GenServer.stop(studio)
  end

  defp get(port, path, header) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])

    request = "GET #{path} HTTP/1.1\r\nhost: localhost\r\n#{header}connection: close\r\n\r\n"
    :ok = :gen_tcp.send(socket, request)
    receive_all(socket, "")
  end

  defp receive_all(socket, acc) do
    case :gen_tcp.recv(socket, 0, 10_000) do
      {:ok, bytes} -> receive_all(socket, acc <> bytes)
      {:error, :closed} -> acc
    end
  end
end
