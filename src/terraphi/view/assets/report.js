draw(JSON.parse(document.getElementById("plots").textContent));
