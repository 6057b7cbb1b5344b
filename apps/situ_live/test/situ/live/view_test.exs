defmodule Situ.Live.ViewTest do
  # Views by the test client: no browser, no server.
  use ExUnit.Case, async: true
  alias Situ.Live.Demo.{Main, Other, Raises}
  alias Situ.Live.Test, as: Page
  import ExUnit.CaptureLog

  defp page(opts \\ []), do: Page.mount(Main, opts)

  test "clicks, branches and attributes" do
    page = page()
    assert Page.text(page, "#count") == "0"
    assert Page.title(page) == "demo"
    assert :ok = Page.click(page, "#inc")
    assert Page.text(page, "#count") == "1"
    assert Page.has?(page, "#closed")
    Page.click(page, "#toggle")
    refute Page.has?(page, "#closed")
    assert Page.text(page, "#open b") == "odd"
    Page.click(page, "#dis")
    assert_raise ArgumentError, ~r/is disabled/, fn -> Page.click(page, "#inc") end
    Page.click(page, "#js")
    assert Page.text(page, "#count") == "2"
  end

  test "a keyed list, with an island that shows part of it" do
    page = page()
    Page.click(page, "#rev")
    Page.click(page, "#add")
    Page.click(page, "#r3 [phx-click=bump]")
    Page.click(page, "#r5 [phx-click=del]")
    assert Page.count(page, "#list li") == 5
    assert Page.attribute(page, "#r3", "class") == "hot"
    assert Page.attribute(page, "#r4", "class") == ""
    assert Page.count(page, "#island tbody tr") == 3
    assert Page.text(page, "#t-4 td") == "row 4"
  end

  test "forms, with nested fields and what is typed escaped" do
    page = page()
    Page.change(page, "#f", %{"f" => %{"q" => "a<b>&\"é"}}, target: ["f", "q"])
    assert Page.text(page, "#note") == "len 7"
    assert Page.attribute(page, "#q", "value") == "a<b>&\"é"
    assert Page.render(page) =~ "a&lt;b&gt;&amp;&quot;é"
    Page.submit(page, "#f", %{"f" => %{"q" => "x"}})
    assert Page.text(page, "#note") == "saved x"
  end

  test "hooks: replies, pushed events, events of the mount" do
    page = page()
    assert Page.pushed(page, "points") == [%{"pts" => 1}]
    assert {:ok, %{"echo" => %{"a" => 1}}} = Page.event(page, "ask", %{a: 1})
    Page.event(page, "draw", %{n: 7})
    assert Page.pushed(page, "points") == [%{"pts" => 7}]
  end

  test "streams: the server forgets the rows, the page keeps them" do
    page = page()
    assert Page.count(page, "#lines li") == 2
    Page.click(page, "#line")
    Page.click(page, "#unline")
    assert Page.text(page, "#lines") == "threetwo"
    assert :sys.get_state(page.view).socket.assigns.streams.lines.inserts == []
    Page.click(page, "#relines")
    assert Page.text(page, "#lines") == "nine"
  end

  test "patches and navigation" do
    page = page(path: "/?tab=b")
    assert Page.text(page, "#tab") == "b"
    Page.click(page, "#patch")
    assert Page.text(page, "#tab") == "c"
    assert Page.visits(page) == [{:live_patch, "/?tab=c"}]
    Page.patch(page, "/?tab=d")
    assert Page.text(page, "#tab") == "d"
    assert {:ok, %{"link_redirect" => true}} = Page.patch(page, "/elsewhere")
    assert {:ok, %{"live_redirect" => "/other"}} = Page.click(page, "#lr")
    Page.click(page, "#go")
    assert {:live_redirect, "/other"} in Page.visits(page)
  end

  test "messages change the page, and what a client sends in the meantime is answered" do
    page = page(session: %{"user" => "ann"})
    assert Page.text(page, "#user") == "ann"
    Page.info(page, {:set, :nasty, "<script>alert(1)</script>"})
    refute Page.render(page) =~ "<script>"
    assert Page.text(page, "#nasty") == "<script>alert(1)</script>"
  end

  test "without acknowledgements diffs still come" do
    page = page(connect_params: %{})
    Page.info(page, {:set, :tick, 5})
    assert Page.text(page, "#tick") == "5"
  end

  test "a view that raises dies alone, with its assigns out of the log" do
    page = page(session: %{"user" => "secret-user"})
    other = page()

    log =
      capture_log(fn ->
        assert {:error, {:view_down, {:shutdown, :crashed}}} = Page.click(page, "#crash")
      end)

    assert log =~ "boom"
    refute log =~ "secret-user"
    refute Page.alive?(page)
    assert Page.text(other, "#count") == "0"
  end

  test "a mount that raises is told" do
    capture_log(fn ->
      assert_raise RuntimeError, ~r/join crashed/, fn -> Page.mount(Raises) end
    end)
  end

  test "malformed messages are refused, and the view lives" do
    page = page()

    for {event, payload} <- [
          {"event", nil},
          {"event", %{}},
          {"event", %{"event" => 7, "type" => "click"}},
          {"event", %{"event" => "form", "type" => "form", "value" => "a=%ff"}},
          {"live_patch", %{}},
          {"cids_destroyed", %{"cids" => "all"}},
          {"no such thing", %{}}
        ] do
      assert {:error, _} = Page.push(page, event, payload)
    end

    for url <- [3, nil, "\0"] do
      assert {:ok, %{"link_redirect" => true}} = Page.push(page, "live_patch", %{"url" => url})
    end

    assert Page.text(page, "#count") == "0"
  end

  test "islands that are gone are told to be gone, those that are shown are not" do
    page = page()
    assert {:ok, %{"cids" => [99]}} = Page.push(page, "cids_destroyed", %{"cids" => [1, 99]})
  end

  test "a static view renders" do
    assert Page.text(Page.mount(Other), "#other") == "other"
  end
end
